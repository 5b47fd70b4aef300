"""The findings from several recordings of one campaign: another force constant, a beginning, an order, lost samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.harness.twin.independent_plant import Ball, wandering
from tests.harness.twin.true_theta import TRUE
from twin.diagnosis.checks.change_point import in_time, share_clock
from twin.diagnosis.checks.consistency import beginnings, contradictions
from twin.diagnosis.report.sentences import contradiction_sentence
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.evidence.sample_loss import lost_samples
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.inference.theta import BASE
from twin.settings import diagnosis as settings

BALL = Ball()


def flights(*balls: Ball, ticks: int = 3000) -> list[Record]:
    records = []
    for n, ball in enumerate(balls):
        flight = ball.closed_loop(wandering(n, ticks, span=1.2e-3), ticks, seed=n, name=f"flight_{n}")
        records.append(replace(flight, t=flight.t + 10.0 * n))
    return records


def test_a_recording_that_asks_for_another_k_c_is_said() -> None:
    plant = BALL.campaign.plant
    reports = []
    for K_c in (1.15 * BALL.K_c, BALL.K_c):
        records = flights(BALL, BALL, replace(BALL, K_c=K_c), ticks=1500)
        criterion = Criterion(gather(records, plant), plant, BALL.tick, workers=1)
        try:
            reports.append(contradictions(criterion, climb(criterion, TRUE, BASE)))
        finally:
            criterion.close()

    another, consistent = reports
    sentences = [contradiction_sentence(contradiction) for contradiction in another]
    assert any(line.startswith("flight_2 contradicts the others: a fit of it alone gives K_c +") for line in sentences)
    assert consistent == []


def test_a_force_that_begins_within_the_campaign_is_dated() -> None:
    plant = BALL.campaign.plant
    heavy = replace(BALL, g=1.1 * BALL.g)  # a force down of a tenth of the weight
    records = flights(BALL, BALL, heavy, heavy)
    criterion = Criterion(gather(records, plant), plant, BALL.tick, workers=1)
    name = "constant-force.force_n"
    try:
        # All parameters but the cause's are known here: what is asked is only whether its own blocks agree.
        fit = climb(criterion, TRUE.having(name, -1e-3), (name,))
        (beginning,) = beginnings(criterion, fit, ["constant-force"])
    finally:
        criterion.close()

    assert beginning.recording == "flight_2"
    assert beginning.t_s == pytest.approx(records[2].t[0], abs=1.0)  # blocks of a second


def test_recordings_are_put_into_the_order_of_one_clock_only_where_there_is_one() -> None:
    records = flights(BALL, BALL, BALL, ticks=200)
    shuffled = [records[2], records[0], records[1]]
    separate_clocks = [replace(record, t=record.t - record.t[0]) for record in shuffled]

    assert in_time(shuffled) == [1, 2, 0]
    assert not share_clock(separate_clocks)
    assert in_time(separate_clocks) == [0, 1, 2]


def test_lost_samples_are_counted_and_pauses_are_not() -> None:
    (record,) = flights(BALL, ticks=5000)
    rng = np.random.default_rng(1)
    keep = rng.random(5000) >= 0.02
    names = ("t", "u_c", "i_c", "x", "x_ref")
    lossy = replace(record, **{name: getattr(record, name)[keep] for name in names})
    paused = replace(record, t=np.where(np.arange(5000) < 2500, record.t, record.t + 1.0))

    loss = lost_samples([lossy])

    assert loss is not None
    assert loss.ci95[0] < np.mean(~keep) < loss.ci95[1]
    assert lost_samples([record]) is None
    assert lost_samples([paused]) is None


def test_a_noise_level_counts_by_its_readings() -> None:
    """The error of the floor's log-likelihood is that of its definition, drawn: 9 of 10 readings are of i_c."""
    counts, errors = (9000, 1000), (0.02, 0.05)
    floor = Floor(sigma_i_c_a=1.0, sigma_x_m=1.0, measured=True, counts=counts, errors=errors)
    logs = np.random.default_rng(3).normal(0.0, errors, (4000, 2))  # of sigma at rest over that in flight

    floors = -(logs @ counts)  # a Gaussian of which sigma is misjudged, its log-likelihood beside that of the right one

    assert floor.tolerance == pytest.approx(settings.NOISE_ERRORS * np.std(floors), rel=0.03)
    assert floor.tolerances == pytest.approx([settings.NOISE_ERRORS * 180.0, settings.NOISE_ERRORS * 50.0])
