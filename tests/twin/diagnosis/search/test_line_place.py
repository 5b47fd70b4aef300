"""A line of x: in the force, in the reading, or either, as the data tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.known_diagnosis import QUIET, steps
from tests.harness.diagnose.simulated_rig import MIDDLE_M, PLANT, TICK_S, rig_of, strong
from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
from twin.diagnosis.search.forward_step import forward
from twin.diagnosis.search.line_place import FORCE, SENSOR, place_gains, place_lead, reading_leads
from twin.diagnosis.search.periodic import FREQUENCY, score
from twin.diagnosis.search.sensor_line import line_scores
from twin.diagnosis.search.stepwise import select
from twin.diagnosis.search.task import Search
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import climb
from twin.inference.initial_guess import start_theta
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, Theta, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings

SIZES = {SENSOR: 5e-6, FORCE: 0.005}  # the force moves the ball by 6 um at 50 Hz


def rig_with(cause: str, frequency_hz: float = 50.0) -> Theta:
    return strong(cause, SIZES[cause], QUIET).having(f"{cause}.frequency_hz", frequency_hz)


def hover(theta: Theta, seed: int) -> Record:
    """A flight at one height."""
    held = Schedule(name=f"hold_{seed}", kind="closed-loop", command=np.full(4000, MIDDLE_M), closed_loop=True)
    (record,) = simulate(rig_of(theta), held, seed=seed)
    return record


def criterion_of(records: list[Record]) -> Criterion:
    return Criterion(gather(records, PLANT), PLANT, TICK_S, workers=1)


def leads(rig: Theta, records: list[Record], cause: str) -> bool:
    criterion = criterion_of(records)
    try:
        gains = place_gains(criterion, rig)
    finally:
        criterion.close()
    return gains[cause] > gains[FORCE if cause == SENSOR else SENSOR] + settings.EQUIVALENT_GAIN


@pytest.mark.parametrize("cause", SIZES)
def test_a_ball_at_rest_tells_a_force_from_a_reading(cause: str) -> None:
    rig = rig_with(cause)
    rest = Schedule(name="rest", kind="free", command=np.full(1500, 1.5), closed_loop=False)

    assert leads(rig, [hover(rig, 1), *simulate(rig_of(rig), rest, seed=2)], cause)


@pytest.mark.parametrize("cause", SIZES)
def test_flights_over_the_travel_tell_a_slow_force_from_a_reading(cause: str) -> None:
    """The force gradient changes with the height, and a slow force moves the ball as far as the gradient lets it."""
    rig = rig_with(cause, 8.0)

    assert leads(rig, [steps(rig, seed=3), steps(rig, seed=4)], cause)


@pytest.mark.parametrize("cause", SIZES)
def test_a_second_line_of_x_has_the_place_that_explains_it(cause: str) -> None:
    """The model has a line at each place, so the other place does not compete as a candidate."""
    rig = rig_with(cause)
    rest = Schedule(name="rest", kind="free", command=np.full(1500, 1.5), closed_loop=False)
    criterion = criterion_of([hover(rig, 1), *simulate(rig_of(rig), rest, seed=2)])
    first = {
        FORCE: strong(FORCE, 1e-5, QUIET).having(f"{FORCE}.frequency_hz", 8.0),
        SENSOR: strong(SENSOR, 1e-7, QUIET).having(f"{SENSOR}.frequency_hz", 120.0),
    }
    try:
        lead_of_sensor = place_lead(criterion, first[FORCE], SENSOR, 50.0)
        lead_of_force = place_lead(criterion, first[SENSOR], FORCE, 50.0)
        scores = line_scores(criterion, climb(criterion, first[FORCE], BASE), [BY_NAME[SENSOR]])
    finally:
        criterion.close()

    assert (lead_of_sensor > settings.EQUIVALENT_GAIN) == (cause == SENSOR)
    assert (lead_of_force > settings.EQUIVALENT_GAIN) == (cause == FORCE)
    assert [score.cause for score in scores] == ([SENSOR] if cause == SENSOR else [])


@pytest.mark.slow
def test_a_second_line_of_the_sensor_is_no_force() -> None:
    rig = rig_with(SENSOR)
    rest = Schedule(name="rest", kind="free", command=np.full(1500, 1.5), closed_loop=False)
    records = [hover(rig, 1), *simulate(rig_of(rig), rest, seed=2)]
    criterion = criterion_of(
        [replace(record, x=record.x + 6e-6 * np.sin(2.0 * np.pi * 33.0 * record.t)) for record in records]
    )
    try:
        base = climb(criterion, QUIET, BASE)
        current = climb(criterion, rig, (*BASE, *coordinates_of(SENSOR)))
        search = Search(criterion=criterion, floor=floor_of(criterion, base.theta), candidates=(BY_NAME[FORCE],))
        line, step = score(criterion, current.theta), forward(search, base, current)
    finally:
        criterion.close()

    assert line is not None
    assert dict(line.other_values)[FREQUENCY] == pytest.approx(33.0, abs=0.1)
    assert step.selected == ""


@pytest.mark.slow
@pytest.mark.parametrize("cause", SIZES)
def test_at_one_height_a_force_and_a_reading_are_one_class(cause: str) -> None:
    rig = rig_with(cause)
    criterion = criterion_of([hover(rig, 1), hover(rig, 2)])
    try:
        base = climb(criterion, QUIET, BASE)
        candidates = BY_NAME[SENSOR], BY_NAME[FORCE]
        search = Search(criterion=criterion, floor=floor_of(criterion, base.theta), candidates=candidates)
        selection = select(search, base)
    finally:
        criterion.close()

    (name,) = selection.causes
    assert {name, *(member.cause for member in selection.classes[name])} == {SENSOR, FORCE}


def test_a_current_that_flows_is_no_error_of_its_reading(tmp_path: Path) -> None:
    """The supply of this rig has a ripple, which the catalogue does not know."""
    make_campaign(tmp_path, effects={}, seed=3, plant="independent", outside={"supply-ripple": 0.04}, quick=True)
    campaign = load(tmp_path / "campaign.toml")
    records = read_campaign(campaign)
    criterion = Criterion(gather(records, campaign.plant), campaign.plant, TICK_S, workers=1)
    try:
        base = climb(criterion, start_theta(records, campaign.plant), BASE)
        lead = reading_leads(criterion, base.theta, 100.0)
        scores = line_scores(criterion, base, [BY_NAME["current-sensor-line"]])
    finally:
        criterion.close()

    assert lead < -settings.EQUIVALENT_GAIN
    assert scores == []
