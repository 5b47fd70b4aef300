"""A single substep for a whole interval, in which the current follows slowly, agrees with many short ones."""

from __future__ import annotations

import ast
import math

import numpy as np
import pytest

from tests.harness.sources import trees
from twin.model.causes import position_dependent_inductance, position_sensor_lag
from twin.model.causes.catalogue import CATALOGUE, neutral
from twin.model.causes.cause import NO_PLACE, Cause, Vector
from twin.model.extended import CORE, FIELD, I_C, I_SENSOR, RATE, SECOND, SENSOR, STATES, Base, V, X
from twin.model.integration import SLOW_SHARE, advance

T_S, PIECES = 2e-3, 64
POSITION_M = 6e-8
CURRENT_A = 5e-5  # a fifth of a count of i_c in a recording (0.24 mA)


@pytest.mark.parametrize(
    "cause", [cause for cause in CATALOGUE if cause.strength.index != NO_PLACE], ids=lambda c: c.name
)
def test_an_interval_within_a_quarter_of_the_time_constant_is_exact(cause: Cause) -> None:
    c = neutral()
    strength = cause.strength
    c[strength.index] = strength.value(strength.coordinate(strength.probes[-1]))

    assert_exact(c, T_A=1.02 * T_S / SLOW_SHARE)


@pytest.mark.parametrize("tau_s", [2e-4, 2e-3])
@pytest.mark.parametrize("second", [0.0, 0.25, 0.5])
def test_a_slow_sensor_shows_what_an_accelerated_ball_does(tau_s: float, second: float) -> None:
    """The reading between two substeps is no straight line: that would be wrong by up to 1 um."""
    c = neutral()
    c[position_sensor_lag.TAU], c[position_sensor_lag.SECOND] = tau_s, second

    assert_exact(c, T_A=3e-4)


@pytest.mark.parametrize("T_A", [3e-4, 1.3e-3])
def test_the_current_of_a_moving_ball_follows_its_inductance(T_A: float) -> None:
    """T_A changes within a substep: with that of its beginning, i would be wrong by some mA."""
    c = neutral()
    c[position_dependent_inductance.GROWTH] = 0.6

    assert_exact(c, T_A=T_A)


def test_no_constant_of_python_says_whether_there_are_stops() -> None:
    """numba would compile the model once more for it, and whatever calls the model."""
    calls = [
        f"{path}:{node.lineno}"
        for path, tree in trees("twin")
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        if node.func.id in ("advance", "over", "propagate")
        if isinstance(node.args[-1], ast.Constant)
    ]

    assert calls == []


def assert_exact(c: Vector, T_A: float) -> None:
    """Compare one `advance` with `PIECES` short ones, from 20 random states."""
    draw = np.random.default_rng(5)
    p = Base(0.297, T_A, 2.751e-6, 0.02, 8.28e-3, 9.81, 5.7e-3, 5.7e-3)
    for _ in range(20):
        gap = draw.uniform(1.5e-3, 5e-3)
        held_a = math.sqrt(p.mass_kg * p.gravity_m_s2 / p.K_c) * gap
        y = np.zeros(STATES)
        y[[I_C, FIELD, SECOND, CORE, I_SENSOR]] = held_a * draw.uniform(0.7, 1.3)
        y[[X, SENSOR]], y[V] = p.x_max_m - gap, draw.uniform(-0.1, 0.1)
        y[RATE] = y[V]
        u = held_a * draw.uniform(0.5, 1.6) / p.K_A
        pieces = y.copy()

        advance(tuple(p), c, y, u, 0.0, T_S, False)
        for k in range(PIECES):
            advance(tuple(p), c, pieces, u, k * T_S / PIECES, T_S / PIECES, False)

        assert y[[X, SENSOR]] == pytest.approx(pieces[[X, SENSOR]], abs=POSITION_M)
        assert y[[I_C, I_SENSOR]] == pytest.approx(pieces[[I_C, I_SENSOR]], abs=CURRENT_A)
