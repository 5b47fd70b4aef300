"""The loop of the iron, against the operators of the literature."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from twin.estimation.record import FloatArray
from twin.model.causes import magnetic_hysteresis as loop
from twin.model.causes.catalogue import neutral
from twin.model.extended import LOOP, STATES, Base, V, X
from twin.model.integration import advance

RIG = Base(K_A=0.3, T_A=0.3e-3, K_c=6e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
WIDTH_A, TURN_A = 0.03, 0.1
SHARPEST = next(shape for shape in loop.CAUSE.shapes if shape.name == "order").low
currents = st.lists(st.floats(0.0, 1.2), min_size=2, max_size=20)


def having(order: float, back: float, turn_a: float = TURN_A) -> FloatArray:
    c = neutral()
    c[loop.HALF_WIDTH], c[loop.TURN], c[loop.ORDER], c[loop.BACK] = WIDTH_A, turn_a, order, back
    return c


def follow_path(c: FloatArray, path: list[float], z: float = 0.0) -> float:
    for before, after in pairwise(path):
        z = loop.turned(c, z, before, after)
    return z


@given(path=currents)
def test_its_limit_is_a_play(path: list[float]) -> None:
    """But for its rounded corners: one costs 0.5 % of the width, ten in a row 1.8 %."""
    c, field = having(SHARPEST, 0.0, turn_a=WIDTH_A), path[0]
    for i in path[1:]:
        field = min(max(field, i - WIDTH_A), i + WIDTH_A)

    assert loop.field(c, path[-1], follow_path(c, path)) == pytest.approx(field, abs=0.03 * WIDTH_A)


@pytest.mark.parametrize(("back", "weight"), [(0.0, 0.5), (1.0, 1.0)], ids=["Bouc-Wen", "Dahl"])
@pytest.mark.parametrize("z", [-0.9, -0.2, 0.0, 0.6])
@pytest.mark.parametrize("change_a", [-0.15, 0.02, 0.3])
def test_of_first_order_it_is_the_equation_of_bouc_and_wen(
    back: float, weight: float, z: float, change_a: float
) -> None:
    """z' = i' - beta |i'| z - gamma i' |z|, divided by i_t; beta = gamma = 1/2, or beta = 1 alone for Dahl's."""
    sign = math.copysign(1.0, change_a)

    def right(_: float, state: FloatArray) -> FloatArray:
        return sign - weight * state - (1.0 - weight) * sign * abs(state)

    truth = solve_ivp(right, (0.0, abs(change_a) / TURN_A), [z], rtol=1e-10, atol=1e-12).y[0, -1]

    assert loop.turned(having(1.0, back), z, 0.5, 0.5 + change_a) == pytest.approx(truth, abs=1e-7)


@given(
    order=st.floats(SHARPEST, 2.0),
    back=st.floats(0.0, 1.0),
    path=currents,
    z=st.floats(-1.0, 1.0),
    part=st.floats(0.0, 1.0),
)
def test_it_depends_on_the_way_of_the_current_alone(
    order: float, back: float, path: list[float], z: float, part: float
) -> None:
    c = having(order, back)
    between = path[-2] + part * (path[-1] - path[-2])
    end = follow_path(c, path, z)

    assert -1.0 <= end <= 1.0
    assert follow_path(c, [*path[:-1], between, path[-1]], z) == pytest.approx(end, abs=2e-6)


def test_the_order_has_a_slope_down_to_its_smallest_value() -> None:
    """Without one the prior alone would move it in a fit, and each such step would be rejected."""
    sharp, rounder = (follow_path(having(order, 0.0), [0.5, 0.5 + TURN_A]) for order in (SHARPEST, SHARPEST + 1e-3))

    assert sharp - rounder > 1e-4


def test_a_falling_ball_is_held_longer_by_the_current_that_came_from_above() -> None:
    ends = []
    for z in (1.0, -1.0):
        y = np.zeros(STATES)
        y[:4] = 0.57, 3e-3, 0.0, 0.57
        y[LOOP] = z
        for _ in range(5):
            advance(tuple(RIG), having(1.0, 0.0), y, 0.57 / 0.3, 0.0, 2e-3, False)
        ends.append((y[X], y[V]))

    assert ends[1][0] > ends[0][0] + 1e-5
    assert ends[1][1] > ends[0][1]
