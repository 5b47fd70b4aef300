"""A line of a sensor is told apart from a force of the same frequency, and from nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.harness.diagnose.known_diagnosis import QUIET, steps
from tests.harness.diagnose.simulated_rig import PLANT, TICK_S, rig_of, strong
from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
from twin.diagnosis.judge.prediction_gain import predictions
from twin.diagnosis.lines import with_sizes
from twin.diagnosis.search.forward_step import forward
from twin.diagnosis.search.sensor_line import find_line
from twin.diagnosis.search.task import Search
from twin.estimation.prediction_floor import floor_rmse
from twin.evidence.gather import gather
from twin.evidence.sensor_noise import sensor_noise
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, Theta
from twin.model.causes.catalogue import BY_NAME

X_LINE, I_LINE, FORCE = "position-sensor-line", "current-sensor-line", "periodic-disturbance"
LINES = tuple(BY_NAME[name] for name in (X_LINE, I_LINE, FORCE))
SIZES = {X_LINE: 20e-6, I_LINE: 8e-3, FORCE: 0.02}  # the force moves the ball by 24 um at 50 Hz
FREQUENCY_HZ = 50.0


@contextmanager
def campaign(theta: Theta, *, seconds: float = 12.0, seed: int = 3) -> Iterator[Criterion]:
    """The ball on its rest, and two flights; each recording has a phase of its own."""
    rest = Schedule(name="rest", kind="free", command=np.full(1500, 1.5), closed_loop=False)
    records = simulate(rig_of(theta), rest, seed=seed)
    records += [steps(theta, seed=seed + n, seconds=seconds) for n in (1, 2)]
    criterion = Criterion(gather(records, PLANT), PLANT, TICK_S, workers=1)
    try:
        yield criterion
    finally:
        criterion.close()


def rig_with(cause: str) -> Theta:
    return strong(cause, SIZES[cause], QUIET).having(f"{cause}.frequency_hz", FREQUENCY_HZ)


@pytest.mark.slow
@pytest.mark.parametrize("cause", SIZES)
def test_a_line_is_named_where_it_is(cause: str) -> None:
    with campaign(rig_with(cause)) as criterion:
        base = climb(criterion, QUIET, BASE)
        search = Search(criterion=criterion, floor=floor_of(criterion, base.theta), candidates=LINES)
        step = forward(search, base, base)
        fit = next(trial.fit for trial in step.trials if trial.cause == step.selected)
        sized, errors = with_sizes(criterion, fit)

    assert step.selected == cause
    name = f"{cause}.{BY_NAME[cause].strength.name}"
    assert fit.theta.value(f"{cause}.frequency_hz") == pytest.approx(FREQUENCY_HZ, abs=3e-3)
    assert sized.theta.value(name) == pytest.approx(SIZES[cause], rel=0.03)
    if cause != FORCE:
        assert abs(sized.theta.value(name) - SIZES[cause]) < 4.0 * errors[name] + 0.01 * SIZES[cause]


def test_a_line_of_the_sensor_is_not_noise_of_the_sensor_at_rest() -> None:
    for theta in (QUIET, rig_with(X_LINE), rig_with(I_LINE)):
        with campaign(theta, seconds=1.0) as criterion:
            sigma_i, sigma_x = sensor_noise(criterion.evidence)
        assert sigma_x == pytest.approx(QUIET.sigma_x_m, rel=0.06)
        assert sigma_i == pytest.approx(QUIET.sigma_i_c_a, rel=0.06)


def test_the_filter_takes_the_line_out_and_predicts_it() -> None:
    rig = rig_with(X_LINE)
    with campaign(rig) as criterion:
        _, white = criterion.white(rig)
        x, samples = criterion.evidence.series.x, criterion.evidence.samples
        error = predictions(criterion.evidence, rig, PLANT, TICK_S, 10) - x
        blind = predictions(criterion.evidence, QUIET, PLANT, TICK_S, 10) - x
        known = np.isfinite(error)
        floor_m = floor_rmse(rig.system(PLANT, TICK_S), samples, 10, known)
        rmse_m = float(np.sqrt(np.mean(error[known] ** 2)))
        blind_m = float(np.sqrt(np.mean(blind[known] ** 2)))

    assert np.nanmean(white[:, 1] ** 2) == pytest.approx(1.0, abs=0.06)
    assert rmse_m == pytest.approx(floor_m, rel=0.08)
    assert blind_m > 1.5 * rmse_m


@pytest.mark.slow
def test_no_line_is_found_in_a_hundred_flights_without_one() -> None:
    for seed in range(50):
        with campaign(QUIET, seconds=2.0, seed=10 * seed) as criterion:
            _, white = criterion.white(QUIET)
            series = criterion.evidence.series
            assert [find_line(series, white, column, TICK_S) for column in (0, 1)] == [None, None], seed
