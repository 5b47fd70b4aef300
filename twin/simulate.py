"""One tick of the paper's model, (1) and (6) between the stops, with the input held; fixed steps, no allocation.

Rule 1: the sample grid is the clock.  One call is one T_s; what happens at a tick happens between two calls.
Rule 2: the amplifier (1) is integrated exactly (T_A may be far below T_s), the ball (6) by classical Runge-Kutta in
        `substeps` equal parts, the force seeing the exact i_c at each stage.
Rule 3: the stops are inelastic: the ball stays where it hits.  The instant of the hit is resolved to one substep.
Rule 4: (3) is singular at x_max, so the force is evaluated with a gap of at least `gap_min_m`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import kernel
from twin.model.parameters import Model

GAP_MIN_SHARE = 0.01  # of the travel: nearer to x_max than this, (3) is not evaluated
SUBSTEPS_MIN, SUBSTEPS_MAX = 4, 64


class PlantNumbers(NamedTuple):
    """The model as the kernels take it, for one T_s; made by `plant_numbers`."""

    K_A: float  # A/V
    k: float  # K_c / m, m^3/(A s)^2
    d: float  # b / m, 1/s
    gravity_m_s2: float
    x_max_m: float
    travel_m: float
    gap_min_m: float
    sample_time_s: float
    substeps: int
    half_step_decay: float  # exp(-h / (2 T_A)) of half a substep h


def plant_numbers(model: Model, sample_time_s: float, *, substeps: int | None = None) -> PlantNumbers:
    """Freeze `model` for ticks of `sample_time_s`.

    Args:
        model: the plant and its four parameters.
        sample_time_s: T_s, s.
        substeps: of Runge-Kutta within a tick; None takes steps of at most T_A / 2, where halving them moves the
            position after a tick by less than 2e-8 m, a hundredth of a converter count (tests/twin/test_simulate.py).
    """
    if substeps is None:
        substeps = min(max(SUBSTEPS_MIN, math.ceil(2.0 * sample_time_s / model.T_A)), SUBSTEPS_MAX)
    return PlantNumbers(
        K_A=model.K_A,
        k=model.K_c / model.plant.mass_kg,
        d=model.b / model.plant.mass_kg,
        gravity_m_s2=model.plant.gravity_m_s2,
        x_max_m=model.plant.x_max_m,
        travel_m=model.plant.travel_m,
        gap_min_m=GAP_MIN_SHARE * model.plant.travel_m,
        sample_time_s=sample_time_s,
        substeps=substeps,
        half_step_decay=math.exp(-0.5 * sample_time_s / substeps / model.T_A),
    )


@kernel
def acceleration(p: PlantNumbers, i: float, x: float, v: float) -> float:
    """Acceleration of (6), m/s^2, free of the stops."""
    gap = max(p.x_max_m - x, p.gap_min_m)
    return p.k * i * i / (gap * gap) - p.d * v - p.gravity_m_s2


@kernel
def substep(
    p: PlantNumbers, h: float, i: float, i_half: float, i_next: float, x: float, v: float
) -> tuple[float, float]:
    """(x, x') after h, i_c being i, i_half and i_next at its beginning, middle and end: m, m/s."""
    a1 = acceleration(p, i, x, v)
    v2 = v + 0.5 * h * a1
    a2 = acceleration(p, i_half, x + 0.5 * h * v, v2)
    v3 = v + 0.5 * h * a2
    a3 = acceleration(p, i_half, x + 0.5 * h * v2, v3)
    v4 = v + h * a3
    a4 = acceleration(p, i_next, x + h * v3, v4)
    x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
    v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    if x <= 0.0:
        x = 0.0
        v = max(v, 0.0)
    elif x >= p.travel_m:
        x = p.travel_m
        v = min(v, 0.0)
    return x, v


@kernel
def tick(p: PlantNumbers, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """(i_c, x, x') one T_s later, with u_c = u held: A, m, m/s."""
    h = p.sample_time_s / p.substeps
    i_end = p.K_A * u
    for _ in range(p.substeps):
        i_half = i_end + (i - i_end) * p.half_step_decay
        i_next = i_end + (i_half - i_end) * p.half_step_decay
        x, v = substep(p, h, i, i_half, i_next, x, v)
        i = i_next
    return i, x, v


@kernel
def ticks(p: PlantNumbers, states: NDArray[np.float64], u: float) -> None:
    """`tick` of several states [i_c, x, x'], shape (3, n), in place.

    The same bits as one after the other, in less than half the time: a substep waits for its divisions, which those of
    the other states fill.
    """
    h = p.sample_time_s / p.substeps
    i_end = p.K_A * u
    for _ in range(p.substeps):
        for k in range(states.shape[1]):
            i = states[0, k]
            i_half = i_end + (i - i_end) * p.half_step_decay
            i_next = i_end + (i_half - i_end) * p.half_step_decay
            states[1, k], states[2, k] = substep(p, h, i, i_half, i_next, states[1, k], states[2, k])
            states[0, k] = i_next
