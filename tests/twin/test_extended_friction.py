"""Dry friction in ticks, against an integration by somebody else: the ball fast, slow, stopping, held and torn off."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.identify.record import FloatArray
from twin.model.causes.catalogue import neutral
from twin.model.causes.coulomb_friction import CREEP_M_S, FORCE
from twin.model.extended import FIELD, I_C, SENSOR, STATES, Base, V, X, advance

RIG = Base(K_A=0.3, T_A=0.3e-3, K_c=6e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
TICK_S = 2e-3
TICKS = 5
BALANCED_V = 1.9  # holds the ball at 3 mm within what strong friction carries


def independent(v: float, u: float, friction_n: float) -> FloatArray:
    def slope(_t: float, y: FloatArray) -> list[float]:
        gap = RIG.x_max_m - y[1]
        force = RIG.K_c * y[0] ** 2 / gap**2 - RIG.b * y[2] - friction_n * math.tanh(y[2] / CREEP_M_S)
        return [(RIG.K_A * u - y[0]) / RIG.T_A, y[2], force / RIG.mass_kg - RIG.gravity_m_s2]

    found = solve_ivp(slope, (0.0, TICKS * TICK_S), [0.57, 3e-3, v], method="LSODA", rtol=1e-9, atol=1e-12)
    return np.asarray(found.y[:, -1])


@pytest.mark.parametrize("friction_n", [0.5e-3, 5e-3, 20e-3])
@pytest.mark.parametrize("v", [-0.15, -0.02, -0.004, 0.0, 0.004, 0.02, 0.15])
@pytest.mark.parametrize("u", [BALANCED_V - 0.2, BALANCED_V, BALANCED_V + 0.2])
def test_ten_milliseconds_end_where_an_adaptive_solver_ends(v: float, u: float, friction_n: float) -> None:
    c, y = neutral(), np.zeros(STATES)
    c[FORCE] = friction_n
    y[I_C], y[X], y[V], y[FIELD], y[SENSOR] = 0.57, 3e-3, v, 0.57, 3e-3

    for tick in range(TICKS):
        advance(tuple(RIG), c, y, u, tick * TICK_S, TICK_S, False)

    truth = independent(v, u, friction_n)
    assert y[X] == pytest.approx(truth[1], abs=1e-7)
    assert y[V] == pytest.approx(truth[2], abs=5e-5)


def test_friction_is_more_than_the_tolerance() -> None:
    assert abs(independent(0.02, BALANCED_V, 5e-3)[1] - independent(0.02, BALANCED_V, 0.0)[1]) > 1e-5
