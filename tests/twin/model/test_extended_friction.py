"""Dry friction in ticks, against an integration by somebody else: the ball fast, slow, stopping, held and torn off."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.estimation.record import FloatArray
from twin.model.causes.catalogue import neutral
from twin.model.causes.coulomb_friction import FORCE
from twin.model.extended import FIELD, I_C, SENSOR, STATES, Base, V, X
from twin.model.integration import advance

RIG = Base(K_A=0.3, T_A=0.3e-3, K_c=6e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
TICK_S = 2e-3
TICKS = 5
START_A, START_M = 0.57, 3e-3
BALANCED_V = 1.9  # holds the ball there within what strong friction carries


def free(y: FloatArray) -> float:
    """Acceleration without dry friction of a ball with i_c, x, x' = y."""
    force = RIG.K_c * y[0] ** 2 / (RIG.x_max_m - y[1]) ** 2 - RIG.b * y[2]
    return float(force / RIG.mass_kg - RIG.gravity_m_s2)


def independent(v: float, u: float, friction_n: float) -> FloatArray:
    """i_c, x, x' after the ticks: from one standstill or start to the next by an adaptive solver with events."""
    limit = friction_n / RIG.mass_kg
    t, y = 0.0, np.array([START_A, START_M, v])
    while t < TICKS * TICK_S - 1e-12:
        held = y[2] == 0.0 and abs(free(y)) <= limit
        way = math.copysign(1.0, y[2] if y[2] != 0.0 else free(y))
        if not held and y[2] == 0.0:
            y[2] = 1e-9 * way  # the event is the next standstill, not this one

        def slope(_t: float, y: FloatArray, held: bool = held, way: float = way) -> list[float]:
            current = (RIG.K_A * u - y[0]) / RIG.T_A
            return [current, 0.0, 0.0] if held else [current, y[2], free(y) - way * limit]

        def changes(_t: float, y: FloatArray, held: bool = held) -> float:
            return abs(free(y)) - limit if held else float(y[2])

        event: Callable[..., float] = changes
        event.terminal, event.direction = True, 1.0 if held else -way  # type: ignore[attr-defined]  # scipy reads them off the function
        solution = solve_ivp(slope, (t, TICKS * TICK_S), y, method="DOP853", events=event, rtol=1e-10, atol=1e-13)
        t, y = float(solution.t[-1]), np.asarray(solution.y[:, -1])
        if solution.t_events is not None and len(solution.t_events[0]):
            y[2] = 0.0
            y[0] += math.copysign(1e-9, free(y)) if held else 0.0  # out of the balance, not just to its edge
    return y


@pytest.mark.parametrize("friction_n", [0.5e-3, 5e-3, 20e-3])
@pytest.mark.parametrize("v", [-0.15, -0.02, -0.004, 0.0, 0.004, 0.02, 0.15])
@pytest.mark.parametrize("u", [BALANCED_V - 0.2, BALANCED_V, BALANCED_V + 0.2])
def test_ten_milliseconds_end_where_an_adaptive_solver_ends(v: float, u: float, friction_n: float) -> None:
    c, y = neutral(), np.zeros(STATES)
    c[FORCE] = friction_n
    y[I_C], y[X], y[V], y[FIELD], y[SENSOR] = START_A, START_M, v, START_A, START_M

    for tick in range(TICKS):
        advance(tuple(RIG), c, y, u, tick * TICK_S, TICK_S, False)

    truth = independent(v, u, friction_n)
    assert y[X] == pytest.approx(truth[1], abs=2e-7)
    assert y[V] == pytest.approx(truth[2], abs=5e-5)


def test_a_held_ball_does_not_creep() -> None:
    c, y = neutral(), np.zeros(STATES)
    c[FORCE] = 20e-3
    y[I_C], y[X], y[FIELD], y[SENSOR] = START_A, START_M, START_A, START_M

    for tick in range(500):
        advance(tuple(RIG), c, y, BALANCED_V, tick * TICK_S, TICK_S, False)

    assert y[X] == START_M


def test_friction_is_more_than_the_tolerance() -> None:
    assert abs(independent(0.02, BALANCED_V, 5e-3)[1] - independent(0.02, BALANCED_V, 0.0)[1]) > 1e-5
