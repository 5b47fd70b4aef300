"""Where the ball can rest: the equilibrium (13) of the model with whatever causes it has.

Rule 1: rest is found from the equations of `extended.py` themselves, first the current that carries the ball, then the
        input that gives that current, each by Brent's method (Algorithms for Minimization without Derivatives, 1973,
        chapter 4) to the last digit.
Rule 2: a position is the true one, or with `shown` the one that the sensor shows: crosstalk and a nonlinear sensor
        make the two differ.
Rule 3: dry friction, which would hold the ball anywhere near, has no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from twin.compiled import Packed, kernel
from twin.model.causes.cause import Vector
from twin.model.extended import (
    FIELD,
    I_C,
    SENSOR,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    acceleration,
    advance,
    current_reading,
    drive,
    position_of_reading,
    position_reading,
)
from twin.model.extension import base, vector
from twin.model.parameters import Model

# Beyond any amplifier: what is not reached by then is not reached.
_LEAST_A, _MOST_A, _LEAST_V, _MOST_V = 1e-3, 1e3, 1e-2, 1e5
_XTOL, _RTOL = 1e-18, 4.0 * float(np.finfo(float).eps)  # the finest relative tolerance that brentq takes
_INPUTS = 300  # tried between these two, 5 % apart
_SETTLING, _SETTLING_STEP_S = 2000, 5e-3


def holding_current(p: Base, c: Vector, x_m: float, *, shown: bool = False) -> float:
    """The coil current that carries the ball at x, A; NaN where none does.

    Args:
        p: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        x_m: where the ball is, m.
        shown: whether `x_m` is what the sensor shows.
    """
    packed = tuple(p)
    if _lift(0.0, packed, c, x_m, shown) > 0.0:
        return math.nan
    low, high = 0.0, _LEAST_A
    while not _lift(high, packed, c, x_m, shown) > 0.0:  # a sensor with crosstalk shows nonsense far above the root
        low, high = high, 2.0 * high
        if high > _MOST_A:
            return math.nan
    return _root(_lift, low, high, packed, c, x_m, shown)


def holding_input(p: Base, c: Vector, i_a: float, warmth_a2: float | None = None) -> float:
    """The u_c behind a steady coil current, V; NaN where the amplifier cannot give it.

    Args:
        p: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        i_a: the coil current, A.
        warmth_a2: mean square of the current that warms the amplifier; None: that of `i_a`.
    """
    packed, w = tuple(p), i_a * i_a if warmth_a2 is None else warmth_a2
    if _surplus(0.0, packed, c, i_a, w) > 0.0:
        return math.nan
    high = _MOST_V
    if not _surplus(high, packed, c, i_a, w) > 0.0:  # an amplifier that folds back gives less again far above
        inputs = np.geomspace(_LEAST_V, _MOST_V, _INPUTS).tolist()
        high = next((u for u in inputs if _surplus(u, packed, c, i_a, w) > 0.0), math.nan)
        if math.isnan(high):
            return math.nan
    return _root(_surplus, 0.0, high, packed, c, i_a, w)


def at_rest(p: Base, c: Vector, x_m: float, *, shown: bool = False) -> tuple[NDArray[np.float64], float]:
    """(state of `extended.py`, shape (7,); u_c in V) of a ball that floats at x.

    The input is NaN where nothing holds the ball there, and the state then one without current.
    """
    i = holding_current(p, c, x_m, shown=shown)
    u = holding_input(p, c, i)
    i = i if math.isfinite(i) else 0.0
    y = np.zeros(STATES)
    y[I_C] = y[FIELD] = i
    y[X] = position_of_reading(p, c, x_m, i) if shown else x_m
    y[SENSOR], y[WARMTH] = position_reading(p, c, y[X], i), i * i
    return y, u


def equilibrium(model: Model, x_m: float) -> tuple[float, float]:
    """(i_c0 as it is read, u_c0) that hold the ball where the sensor shows `x_m`, (13); A, V; NaN where none do."""
    p, c = base(model), vector(model.causes)
    y, u = at_rest(p, c, x_m, shown=True)
    return (float(current_reading(c, y[I_C])), u) if math.isfinite(u) else (math.nan, math.nan)


def settled_current(p: Base, c: Vector, u_v: float, x_m: float = 0.0) -> float:
    """What i_c comes to under a constant u_c, A, the ball held at x and the coil as warm as that current makes it.

    Simulated, not solved: whatever bends the amplifier's response is in the equations of motion alone.
    """
    packed = tuple(p)
    y = np.zeros(STATES)
    y[I_C] = y[FIELD] = drive(p, c, u_v, 0.0)
    for _ in range(_SETTLING):
        before = float(y[I_C])
        y[X], y[V], y[WARMTH] = x_m, 0.0, before**2
        advance(packed, c, y, u_v, 0.0, _SETTLING_STEP_S, True)
        if abs(y[I_C] - before) <= 1e-12:
            break
    return float(y[I_C])


@kernel
def _lift(i: float, base: Packed, c: Vector, x_m: float, shown: bool) -> float:
    """Acceleration of a ball that lies still at x under the current i, m/s^2."""
    p = Base(*base)
    x = position_of_reading(p, c, x_m, i) if shown else x_m
    return acceleration(p, c, i, x, 0.0, 0.0)


@kernel
def _surplus(u: float, base: Packed, c: Vector, i: float, w: float) -> float:
    """By how much the current that the amplifier aims at under u exceeds i, A."""
    return drive(Base(*base), c, u, w) - i


def _root(rising: Callable[..., float], low: float, high: float, *rest: object) -> float:
    return float(brentq(rising, low, high, args=rest, xtol=_XTOL, rtol=_RTOL))
