"""The voltage that a moving ball induces, against an integration by somebody else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.estimation.record import FloatArray
from twin.model.causes import current_sensor_lag, eddy_current_lag, position_sensor_lag
from twin.model.causes.catalogue import neutral
from twin.model.causes.motional_emf import COUPLING
from twin.model.extended import FIELD, I_C, SENSOR, STATES, Base, V, X
from twin.model.integration import advance

RIG = Base(K_A=0.3, T_A=0.3e-3, K_c=6e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
TICK_S = 2e-3
STRONG = 1.0  # s/m, 25 times what a coil of 10 ohm has


def independent(i: float, x: float, v: float, u: float, coupling: float) -> FloatArray:
    middle = RIG.x_max_m - 0.5 * RIG.travel_m

    def slope(_t: float, y: FloatArray) -> list[float]:
        gap = RIG.x_max_m - y[1]
        voltage = coupling * y[0] * y[2] * (middle / gap) ** 2
        force = RIG.K_c * y[0] ** 2 / gap**2 - RIG.b * y[2]
        return [(RIG.K_A * u - voltage - y[0]) / RIG.T_A, y[2], force / RIG.mass_kg - RIG.gravity_m_s2]

    solution = solve_ivp(slope, (0.0, TICK_S), [i, x, v], method="LSODA", rtol=1e-9, atol=1e-12)
    return np.asarray(solution.y[:, -1])


@pytest.mark.parametrize(
    ("i", "x", "v", "u"),
    [(0.12, 2.2e-3, -0.23, 3.9), (1.2, 2.2e-3, 0.2, 0.3), (0.6, 3.0e-3, 0.05, 2.0), (0.5, 1.0e-3, -0.1, 1.7)],
)
def test_after_a_tick_the_current_is_within_the_sensor_noise(i: float, x: float, v: float, u: float) -> None:
    """4 mA where u_c jumps by 3.6 V in a ball that falls at 0.23 m/s: without the voltage 290 mA are wrong."""
    c, y = neutral(), np.zeros(STATES)
    c[COUPLING] = STRONG
    y[I_C], y[X], y[V], y[FIELD], y[SENSOR] = i, x, v, i, x

    advance(tuple(RIG), c, y, u, 0.0, TICK_S, False)

    truth = independent(i, x, v, u, STRONG)
    assert y[I_C] == pytest.approx(truth[0], abs=4e-3)
    assert y[X] == pytest.approx(truth[1], abs=1e-6)
    assert y[V] == pytest.approx(truth[2], abs=1e-3)
    assert abs(independent(i, x, v, u, 0.0)[0] - truth[0]) > 0.01


LAGS = (eddy_current_lag.TAU, position_sensor_lag.TAU, current_sensor_lag.TAU)


@pytest.mark.parametrize("part", [0.0, 1e-19])
@pytest.mark.parametrize(("index", "value"), [(COUPLING, STRONG), *((lag, 1e-3) for lag in LAGS)])
def test_an_interval_of_no_length_changes_nothing(index: int, value: float, part: float) -> None:
    """Under a delay of a whole number of intervals nothing but rounding is left of the first part."""
    c, y = neutral(), np.zeros(STATES)
    c[index] = value
    y[I_C], y[X], y[V], y[FIELD], y[SENSOR] = 0.5, 1.0e-3, -0.1, 0.5, 1.0e-3
    before = y.copy()

    advance(tuple(RIG), c, y, 3.0, 0.0, part, False)

    assert y == pytest.approx(before, rel=1e-12)


def test_a_ball_pressed_to_its_stop_induces_nothing() -> None:
    c, y = neutral(), np.zeros(STATES)
    c[COUPLING] = STRONG
    y[I_C] = y[FIELD] = 0.1

    advance(tuple(RIG), c, y, 1.0, 0.0, TICK_S, True)

    assert y[X] == y[V] == 0.0
    assert y[I_C] == pytest.approx(0.3 - 0.2 * np.exp(-TICK_S / RIG.T_A), abs=1e-9)
