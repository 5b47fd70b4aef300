"""A ball that the magnet pulls against the coil: it arrives, stays, and falls when the current ends."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.extended import STATES, Base, V, X
from twin.model.integration import over
from twin.model.parameters import Model

T_S = 2e-3
MODEL = Model.load("ce152")
BASE = Base(
    **{name: MODEL.parameters[name].value for name in ("K_A", "T_A", "K_c", "b")},
    mass_kg=MODEL.plant.mass_kg,
    gravity_m_s2=MODEL.plant.gravity_m_s2,
    x_max_m=MODEL.plant.x_max_m,
    travel_m=MODEL.plant.travel_m,
)


def flight(drag: float, *inputs_v: float, ticks: int = 100) -> NDArray[np.float64]:
    """Position and speed at each tick, shape (ticks for each input, 2)."""
    c = neutral()
    c[BY_NAME["quadratic-drag"].strength.index] = drag
    y, rows = np.zeros(STATES), []
    for k, u_c in enumerate(np.repeat(inputs_v, ticks)):
        over(tuple(BASE), c, y, float(u_c), k * T_S, T_S, True)
        rows.append((y[X], y[V]))
    return np.array(rows)


@pytest.mark.parametrize("drag", [0.0, 0.2, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("u_c", [5.0, 7.0, 10.0])
def test_it_stays_at_the_stop_and_falls_when_the_current_ends(drag: float, u_c: float) -> None:
    up, down = np.split(flight(drag, u_c, 0.0), 2)

    assert np.isfinite(up).all()
    assert tuple(up[-1]) == (BASE.travel_m, 0.0)
    assert np.flatnonzero(up[:, 0] == BASE.travel_m).min() + np.count_nonzero(up[:, 0] == BASE.travel_m) == len(up)
    assert tuple(down[-1]) == (0.0, 0.0)
    assert (np.diff(down[:, 0]) <= 0.0).all()


@pytest.mark.parametrize("drag", [0.0, 1.0])
def test_it_arrives_in_the_tick_that_a_fine_integration_gives(drag: float) -> None:
    u_c = 5.0
    capital_i = BASE.K_A * u_c

    def slopes(t: float, state: NDArray[np.float64]) -> list[float]:
        x, v = state
        gap = max(BASE.x_max_m - x, 0.01 * BASE.travel_m)
        pull = BASE.K_c * (capital_i * (1.0 - np.exp(-t / BASE.T_A))) ** 2 / gap**2
        a = (pull - BASE.b * v - drag * v * abs(v)) / BASE.mass_kg - BASE.gravity_m_s2
        return [v, a if x > 0.0 or a > 0.0 else 0.0]

    def arrives(_: float, state: NDArray[np.float64]) -> float:
        return float(state[0] - BASE.travel_m)

    arrives.terminal = True  # type: ignore[attr-defined]  # as scipy asks
    exact = solve_ivp(slopes, (0.0, 0.2), [0.0, 0.0], events=arrives, rtol=1e-9, atol=1e-12, max_step=1e-4)

    (arrival,) = np.array(exact.t_events)[0]
    tick = int(np.flatnonzero(flight(drag, u_c)[:, 0] == BASE.travel_m).min()) + 1
    assert abs(tick * T_S - arrival) < 1.5 * T_S
