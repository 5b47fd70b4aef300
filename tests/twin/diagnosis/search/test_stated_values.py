"""A campaign that states something wrong: what takes the error up, and what a measurement beside the board settles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from protocol.campaign import Plant
from tests.harness.diagnose.simulated_rig import ITEMS, PLANT, THETA, criterion_of, made, narrow
from twin.diagnosis.search.candidate_fits import fit_candidates
from twin.diagnosis.search.score_test import screen
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stated_values import StatedValues, examine, with_members
from twin.estimation.record import Record
from twin.evidence.starting.liftoff import LiftOff
from twin.inference.fisher_scoring import climb
from twin.inference.outside import Outside
from twin.inference.theta import BASE, STOPS
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.stated import STATED

FORCE, GAP, GAIN = "constant-force", "air-gap-offset", "position-sensor-gain"
GRAVITY, CLOCK, SCALE = "stated-gravity", "stated-clock", "stated-x-scale"


@pytest.fixture(scope="module")
def flown() -> list[Record]:
    """Provide recordings of a rig without any cause: steps of the amplifier, a flight, throws from stop to stop."""
    return [*narrow(THETA), *made(ITEMS["prbs-open-loop"], THETA)]


def examined(records: Sequence[Record], plant: Plant, *causes: str) -> tuple[Selection, StatedValues]:
    """Fit the paper's model and then each cause, as the search does, and ask for the stated values."""
    criterion = criterion_of(list(records), plant)
    try:
        fit = climb(criterion, THETA, (*BASE, *STOPS))
        selection = Selection(base=fit, fit=fit)
        for cause in causes:
            before = selection.fit
            (trial, *_) = fit_candidates(
                criterion, before, screen(criterion, before.theta, before.free, [BY_NAME[cause]])
            )
            selection = replace(selection, fit=trial.fit, causes=(*selection.causes, cause), gains={cause: trial.gain})
        return selection, examine(criterion, selection)
    finally:
        criterion.close()


def errors(stated: StatedValues, cause: str) -> dict[str, float]:
    """The error of each stated value that explains as much as the cause."""
    return {
        trial.cause: trial.fit.theta.value(f"{trial.cause}.{BY_NAME[trial.cause].strength.name}")
        for trial in stated.classes[cause]
    }


def absorbed(stated: StatedValues) -> dict[str, tuple[str, ...]]:
    return {entry.cause: entry.by for entry in stated.absorbed}


def slow(records: Sequence[Record], share: float) -> list[Record]:
    """The recordings of a board whose clock is slow."""

    def timed(record: Record) -> Record:
        captures = tuple(
            replace(capture, sample_time_s=capture.sample_time_s / (1.0 + share)) for capture in record.captures
        )
        return replace(record, t=record.t / (1.0 + share), captures=captures)

    return [timed(record) for record in records]


def test_a_wrong_mass_is_in_no_recording_and_k_c_takes_it_up(flown: list[Record]) -> None:
    _, right = examined(flown, PLANT)
    _, wrong = examined(flown, replace(PLANT, mass_kg=1.06 * PLANT.mass_kg))

    for stated in (right, wrong):
        assert absorbed(stated)["stated-mass"][:1] == ("K_c",)
        assert absorbed(stated)["stated-input"] == ("K_A",)
        assert not {GRAVITY, CLOCK, SCALE, "stated-x-max", "stated-travel"} & absorbed(stated).keys()


def test_a_wrong_g_is_a_constant_force_or_a_clock(flown: list[Record]) -> None:
    selection, stated = examined(flown, replace(PLANT, gravity_m_s2=1.02 * PLANT.gravity_m_s2), FORCE)

    force_n = selection.fit.theta.value(f"{FORCE}.force_n")
    relative_errors = errors(stated, FORCE)
    assert set(relative_errors) == {GRAVITY, CLOCK}
    # What is equivalent by the physics: the same force, the square of the time.
    assert relative_errors[GRAVITY] == pytest.approx(-force_n / (PLANT.mass_kg * 1.02 * PLANT.gravity_m_s2), rel=0.02)
    assert (1.0 + relative_errors[CLOCK]) ** 2 == pytest.approx(1.0 + relative_errors[GRAVITY], abs=5e-4)
    assert relative_errors[GRAVITY] == pytest.approx(1.0 / 1.02 - 1.0, abs=0.006)


def test_a_slow_clock_is_in_the_class_with_its_size(flown: list[Record]) -> None:
    _, stated = examined(slow(flown, 0.02), PLANT, FORCE)

    assert errors(stated, FORCE)[CLOCK] == pytest.approx(0.02, abs=0.003)


@pytest.mark.parametrize(("measured", "stays"), [(0.0, False), (0.02, True)])
def test_the_computers_clock_rules_out_that_of_the_board_or_confirms_it(
    flown: list[Record], measured: float, stays: bool
) -> None:
    timed = [replace(record, clock_error=(measured, 5e-4)) for record in slow(flown, 0.02)]

    _, stated = examined(timed, PLANT, FORCE)

    assert (CLOCK in errors(stated, FORCE)) is stays
    assert GRAVITY in errors(stated, FORCE)


def test_a_wrong_x_max_is_a_coil_that_sits_elsewhere(flown: list[Record]) -> None:
    selection, stated = examined(flown, replace(PLANT, x_max_m=PLANT.x_max_m + 0.2e-3), GAP)

    assert errors(stated, GAP) == {"stated-x-max": pytest.approx(-0.2e-3, abs=0.01e-3)}
    (member,) = with_members(selection, stated).classes[GAP]
    assert member.fit.loglik == pytest.approx(selection.fit.loglik, abs=0.1)


def test_a_wrong_scale_of_x_is_ruled_out_as_anything_else_by_the_stops(flown: list[Record]) -> None:
    scaled = [replace(record, x=1.03 * record.x, x_ref=1.03 * record.x_ref) for record in flown]

    selection, stated = examined(scaled, PLANT, GAIN)

    assert selection.fit.theta.value(f"{GAIN}.gain") == pytest.approx(1.03, abs=0.002)
    assert stated.classes[GAIN] == ()


def test_the_balance_at_rest_holds_for_a_constant_force_as_for_another_g() -> None:
    """A point of lift-off showed the weight alone, so that it contradicted each force and not the g that equals it."""
    gap, force_n = 5e-3, 2e-3
    i = gap * math.sqrt((PLANT.mass_kg * PLANT.gravity_m_s2 - force_n) / THETA.K_c)
    point = LiftOff(recording="r", t_s=0.0, gap_m=gap, i_c_a=i, K_c=THETA.K_c, relative_error=0.005)
    outside = Outside(statics=(point,), plant=PLANT, share=1.0)

    pulled = THETA.having(f"{FORCE}.force_n", force_n)
    lighter = THETA.having(f"{GRAVITY}.error", -force_n / (PLANT.mass_kg * PLANT.gravity_m_s2))

    assert outside.points(pulled) == pytest.approx(0.0, abs=1e-12)
    assert outside.points(lighter) == pytest.approx(0.0, abs=1e-12)
    assert outside.points(THETA) < -2.0


def test_the_balance_at_rest_is_that_of_true_values_not_of_readings() -> None:
    gap, offset_m, offset_a = 5e-3, 0.2e-3, 0.02
    i = gap * math.sqrt(PLANT.mass_kg * PLANT.gravity_m_s2 / THETA.K_c)
    point = LiftOff(
        recording="r", t_s=0.0, gap_m=gap - offset_m, i_c_a=i + offset_a, K_c=THETA.K_c, relative_error=0.005
    )
    outside = Outside(statics=(point,), plant=PLANT, share=1.0)

    sensors = THETA.having("position-sensor-offset.offset_m", offset_m).having(
        "current-sensor-offset.offset_a", offset_a
    )

    assert outside.points(sensors) == pytest.approx(0.0, abs=1e-9)


def test_a_suspect_without_an_error_changes_nothing() -> None:
    theta = THETA
    for suspect in STATED:
        theta = theta.having(f"{suspect.name}.{suspect.strength.name}", 0.0)

    assert theta.base(PLANT) == THETA.base(PLANT)
    assert np.array_equal(theta.vector(), THETA.vector())
    assert not {suspect.name for suspect in STATED} & {cause.name for cause in CATALOGUE}
