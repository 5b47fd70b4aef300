"""An offset that wanders: a flight with a known random walk, and what the filter says of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.known_diagnosis import QUIET, steps
from tests.harness.diagnose.simulated_rig import MIDDLE_M, PLANT, TICK_S
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion, mean_square
from twin.inference.theta import BASE, Theta, coordinates_of, parameter_of
from twin.model.causes.catalogue import OFFSETS
from twin.model.causes.wander import MINUTE_S
from twin.model.equilibrium import at_rest
from twin.model.extended import I_C, V, X, current_reading, position_reading
from twin.model.integration import advance

# The wander after a minute, large enough to show within half a minute.
WANDERS = {
    "position-sensor-offset.wander_m": 0.0002,
    "current-sensor-offset.wander_a": 0.05,
}
SECONDS = 30.0


def flight(theta: Theta, name: str, wander: float, seed: int) -> Record:
    """A ball under a PD law that knows its speed, while the offset that `name` belongs to walks; noisy readings."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS / TICK_S)
    base, c = theta.base(PLANT), theta.vector()
    offset = next(index for index, walk in OFFSETS if walk == parameter_of(name).index)
    y, u_0 = at_rest(base, c, MIDDLE_M)
    step = wander * math.sqrt(TICK_S / MINUTE_S)
    rows = np.empty((n, 4))
    for k in range(n):
        target_m = MIDDLE_M + 0.5e-3 * (1.0 if k % 300 < 150 else -1.0)
        u = u_0 + 900.0 * (target_m - y[X]) - 22.0 * y[V]
        reading_i = current_reading(c, y[I_C]) + theta.sigma_i_c_a * rng.normal()
        reading_x = position_reading(base, c, y[X], y[I_C]) + theta.sigma_x_m * rng.normal()
        rows[k] = u, reading_i, reading_x, target_m
        advance(tuple(base), c, y, u, 0.0, TICK_S, False)
        c[offset] += step * rng.normal()
    t = TICK_S * np.arange(n, dtype=np.float64)
    return replace(
        steps(theta, seed=1, seconds=0.5), t=t, u_c=rows[:, 0], i_c=rows[:, 1], x=rows[:, 2], x_ref=rows[:, 3]
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "wander"), WANDERS.items())
def test_how_far_an_offset_wanders_is_found(name: str, wander: float) -> None:
    """Within four standard errors, and what is left is white noise; without the wander it is not."""
    usual, *_ = coordinates_of(name.partition(".")[0])
    criterion = Criterion(gather([flight(QUIET, name, wander, 5)], PLANT), PLANT, TICK_S, workers=1)
    try:
        fixed = climb(criterion, QUIET, BASE)
        free = climb(criterion, QUIET.having(usual, 0.0).having(name, 0.3 * wander), (*BASE, usual, name), passes=60)
        white = mean_square(criterion.outputs(free.theta))
    finally:
        criterion.close()

    assert free.converged
    assert free.loglik > fixed.loglik + 20.0
    assert abs(free.theta.value(name) - wander) < 4.0 * free.std(name, PLANT)
    assert free.std(name, PLANT) < 0.5 * wander
    assert white == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", WANDERS)
def test_an_offset_that_stays_does_not_wander(name: str) -> None:
    usual, *_ = coordinates_of(name.partition(".")[0])
    criterion = Criterion(gather([flight(QUIET, name, 0.0, 6)], PLANT), PLANT, TICK_S, workers=1)
    try:
        fixed = climb(criterion, QUIET, (*BASE, usual))
        free = climb(criterion, QUIET.having(name, 0.3 * WANDERS[name]), (*BASE, usual, name), passes=60)
    finally:
        criterion.close()

    assert free.loglik < fixed.loglik + 4.0
    assert free.theta.value(name) < 0.3 * WANDERS[name]
