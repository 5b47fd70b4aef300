"""The current of a held ball: the amplifier without the ball is the whole model with a ball that cannot move."""

from __future__ import annotations

import numpy as np
import pytest

from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.extended import FIELD, I_C, SENSOR, STATES, Base, X, held_current, over

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
        c[next(one for one in BY_NAME[name].parameters if one.name == parameter).index] = value
    for i, u in ((0.2, 3.0), (0.8, 0.0), (0.6, 2.2), (0.0, 0.0)):
        y = np.zeros(STATES)
        y[I_C] = y[FIELD] = i
        y[X] = y[SENSOR] = HELD_M
        over(tuple(HELD), c, y, u, 0.0, duration, False)

        assert held_current(HELD, c, i, 0.0, HELD_M, u, duration) == pytest.approx(y[I_C], rel=1e-9, abs=1e-12)
