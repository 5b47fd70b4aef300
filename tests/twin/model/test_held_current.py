"""The current of a held ball: the amplifier without the ball is the whole model with a ball that cannot move."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.estimation.record import FloatArray
from twin.model.causes import freewheel_diode
from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.extended import FIELD, I_C, SENSOR, STATES, Base, X, held_current
from twin.model.integration import over

HELD_M = 2e-3
HELD = Base(K_A=0.3, T_A=4e-4, K_c=5.6e-6, b=0.02, mass_kg=1e12, gravity_m_s2=0.0, x_max_m=8.1e-3, travel_m=5.7e-3)
AMPLIFIERS = {
    "": {},
    "freewheel-diode": {"drop_v": 0.6},
    "slew-rate-limit": {"rate_a_s": 300.0},
    "position-dependent-inductance": {"growth": 0.8, "reach": 0.5, "voltage": 1.0},
    "motional-emf": {"coupling_s_m": 0.5},
    "amplifier-offset": {"offset_a": -0.1, "rounding": 0.4},
    "amplifier-dead-zone": {"width_v": 0.4},
    "current-limit": {"limit_a": 0.9},
}


@pytest.mark.parametrize("name", AMPLIFIERS)
@pytest.mark.parametrize("duration", [5e-5, 7e-4, 2e-3, 5e-3])
def test_a_ball_that_cannot_move_changes_nothing(name: str, duration: float) -> None:
    c = neutral()
    for parameter, value in AMPLIFIERS[name].items():
        c[next(item for item in BY_NAME[name].parameters if item.name == parameter).index] = value
    for i, u in ((0.2, 3.0), (0.8, 0.0), (0.6, 2.2), (0.0, 0.0)):
        y = np.zeros(STATES)
        y[I_C] = y[FIELD] = i
        y[X] = y[SENSOR] = HELD_M
        over(tuple(HELD), c, y, u, 0.0, duration, False)

        assert held_current(HELD, c, i, 0.0, HELD_M, u, duration) == pytest.approx(y[I_C], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("offset_a", [-0.05, 0.0, 0.05])
@pytest.mark.parametrize("rate_a_s", [np.inf, 400.0])
def test_the_current_through_a_diode_solves_its_equation(offset_a: float, rate_a_s: float) -> None:
    c = neutral()
    diode, rate = BY_NAME["freewheel-diode"].strength.index, BY_NAME["slew-rate-limit"].strength.index
    c[diode], c[rate], c[BY_NAME["amplifier-offset"].strength.index] = 0.6, rate_a_s, offset_a

    def slope(_: float, i: FloatArray, u: float) -> FloatArray:
        lost = freewheel_diode.lost_v(c, u, i[0], HELD.K_A)
        aim = max(HELD.K_A * u + offset_a, 0.0) - HELD.K_A * lost
        return np.clip((aim - i) / HELD.T_A, -rate_a_s, rate_a_s)

    for i, u in ((0.9, 0.0), (0.9, 0.2), (0.3, 0.5), (0.0, 0.1), (0.05, 0.3), (0.9, 1.5)):
        for duration in (1e-4, 6e-4, 3e-3):
            solved = solve_ivp(slope, (0.0, duration), [i], args=(u,), rtol=1e-9, atol=1e-11, max_step=1e-5)

            assert held_current(HELD, c, i, 0.0, HELD_M, u, duration) == pytest.approx(solved.y[0, -1], abs=2e-7)
