"""Equilibria (13) of the model with its causes.

Rule 1: the equations are those of `extended.py`.  Bisection gives first the current that carries the ball, then the
        input that gives this current.
Rule 2: a position is the true position, or with `as_reading` the sensor's reading.  Crosstalk and a nonlinear sensor
        make them differ.
Rule 3: dry friction is left out: with it every position near an equilibrium would be one, too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.model.causes.cause import Vector
from twin.model.extended import (
    I_C,
    SENSOR,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    acceleration,
    current_reading,
    drive,
    lasting_warmth,
    position_of_reading,
    position_reading,
    settle_current,
)
from twin.model.extension import base, vector
from twin.model.integration import STOPS, advance
from twin.model.parameters import Model

# The upper limits are beyond any amplifier.
_MIN_A, _MAX_A, _MIN_V, _MAX_V = 1e-3, 1e3, 1e-2, 1e5
_INPUT_STEP = 1.055  # ratio of inputs that are tried from _MIN_V on
_SETTLING, _SETTLING_STEP_S = 2000, 5e-3


def holding_current(p: Base, c: Vector, x_m: float, *, as_reading: bool = False) -> float:
    """The coil current that carries the ball at x, A; NaN if no current does.

    Args:
        p: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        x_m: position of the ball, m.
        as_reading: whether `x_m` is the sensor's reading.
    """
    return _holding_current(tuple(p), c, x_m, as_reading)


def holding_input(p: Base, c: Vector, i_a: float) -> float:
    """The u_c that gives a steady coil current, V; NaN if the amplifier cannot give it.

    Args:
        p: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        i_a: the coil current, A, which has warmed the amplifier.
    """
    return _holding_input(tuple(p), c, i_a, lasting_warmth(c, i_a))


def at_rest(p: Base, c: Vector, x_m: float, *, as_reading: bool = False) -> tuple[NDArray[np.float64], float]:
    """Return the state, shape (STATES,), and u_c, V, of a ball that floats at x; arguments as `holding_current`.

    If nothing holds the ball there, the input is NaN and the state has no current.
    """
    i = holding_current(p, c, x_m, as_reading=as_reading)
    u = holding_input(p, c, i)
    i = i if math.isfinite(i) else 0.0
    y = np.zeros(STATES)
    settle_current(c, y, i)
    y[X] = position_of_reading(p, c, x_m, i) if as_reading else x_m
    y[SENSOR] = position_reading(p, c, y[X], i)
    return y, u


def equilibrium(model: Model, x_m: float) -> tuple[float, float]:
    """Return (reading of i_c0 in A, u_c0 in V) that hold the ball at the reading `x_m`, (13); NaN if there are none."""
    p, c = base(model), vector(model.causes)
    y, u = at_rest(p, c, x_m, as_reading=True)
    return (float(current_reading(c, y[I_C])), u) if math.isfinite(u) else (math.nan, math.nan)


def steady_current(p: Base, c: Vector, u_v: float) -> float:
    """Return the steady-state i_c under a constant u_c, A, with the ball held at 0 and the coil at its steady warmth.

    It is simulated because some causes of the amplifier appear only in the differential equations.
    """
    packed = tuple(p)
    y = np.zeros(STATES)
    settle_current(c, y, drive(p, c, u_v, 0.0))
    for _ in range(_SETTLING):
        before = float(y[I_C])
        y[X], y[V], y[WARMTH] = 0.0, 0.0, lasting_warmth(c, before)
        # A step longer than `advance` is exact for: only where the current comes to rest counts, not how it gets there.
        advance(packed, c, y, u_v, 0.0, _SETTLING_STEP_S, STOPS)
        if abs(y[I_C] - before) <= 1e-12:
            break
    return float(y[I_C])


@kernel
def _holding_current(base: Packed, c: Vector, x_m: float, as_reading: bool) -> float:
    # Bisection until low and high are neighbouring numbers.  Not Newton: a dead zone or a limit makes the slope 0.  Not
    # Brent's method: its import takes 18 MB in every twin.
    if _lift(0.0, base, c, x_m, as_reading) > 0.0:
        return math.nan
    low, high = 0.0, _MIN_A
    # Doubled from below, not bracketed by _MAX_A: far above the root, readings with crosstalk are meaningless.
    while not _lift(high, base, c, x_m, as_reading) > 0.0:
        low, high = high, 2.0 * high
        if high > _MAX_A:
            return math.nan
    middle = 0.5 * (low + high)
    while low < middle < high:
        low, high = (low, middle) if _lift(middle, base, c, x_m, as_reading) > 0.0 else (middle, high)
        middle = 0.5 * (low + high)
    return middle


@kernel
def _lift(i: float, base: Packed, c: Vector, x_m: float, as_reading: bool) -> float:
    """Return the acceleration of a ball at rest at x under the current i, m/s^2."""
    p = Base(*base)
    x = position_of_reading(p, c, x_m, i) if as_reading else x_m
    return acceleration(p, c, i, x, 0.0, 0.0)


@kernel
def _holding_input(base: Packed, c: Vector, i: float, w: float) -> float:
    if _surplus(0.0, base, c, i, w) > 0.0:
        return math.nan
    low, high = 0.0, _MAX_V
    if not _surplus(high, base, c, i, w) > 0.0:  # with foldback the current falls again far above
        # From below, in small steps: the range of inputs that give this current may be narrow, and ends.
        high = _MIN_V
        while not _surplus(high, base, c, i, w) > 0.0:
            low, high = high, _INPUT_STEP * high
            if high > _MAX_V:
                return math.nan
    middle = 0.5 * (low + high)
    while low < middle < high:
        low, high = (low, middle) if _surplus(middle, base, c, i, w) > 0.0 else (middle, high)
        middle = 0.5 * (low + high)
    return middle


@kernel
def _surplus(u: float, base: Packed, c: Vector, i: float, w: float) -> float:
    """Return the steady-state current under u minus i, A."""
    return drive(Base(*base), c, u, w) - i
