"""Equations of motion of the emulated rig and their integration.  Pure functions; no noise, no clock.

All quantities in SI units; x is up from the sensor.

    amplifier  T(x) i' = K_A(w) u_del + offset - i - emf, limited in rate and value          after (1)
    heating    30 s w' = i^2 - w
    field      tau f' = i - f                                      (without lag: f = i)
    ball       m v' = K_c f^2/gap^2 - m g - b v - c|v|v - friction + disturbances            after (6)
    sensor     tau s' = reading(x, i) - s                         (without lag: s = reading)

Rule 1: the step is fixed, so the same inputs give the same bits however a span is cut into calls.
Rule 2: a stop is an event.  The step is cut where the ball touches (bisection), and the speed is reversed there.  Then
        the rest of the step follows.  A stiff spring instead would allow penetration, and its result would depend on
        where the steps fall.
Rule 3: a ball that rests on a stop, or is held by dry friction, keeps its x bit for bit.

Classical Runge-Kutta of 4th order in between.  At 20 us and T_A = 300 us its error in i_c stays below 1e-7 of a jump,
far under the noise; an Euler step of that error would have to be far below 1 ns.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
# tuple(of a NamedTuple): a call into compiled code reads a NamedTuple by its names, a third of what such a call costs.
Packed: TypeAlias = tuple[Any, ...]
P = ParamSpec("P")
R = TypeVar("R")

REST_SPEED_M_S = 1e-3  # slower rebounds end at rest: their hop, v^2/2g = 0.05 um, is a hundredth of the noise
_EVENTS_PER_STEP = 20  # a hop above REST_SPEED_M_S lasts 9 us even under the full current, so three fit
_BISECTIONS = 40  # locates an event to 20 us * 2^-40 = 2e-17 s


class PlantState(NamedTuple):
    """The state of the rig."""

    i: float  # coil current, A
    f: float  # current that the force sees, A
    x: float  # position, m, up from the sensor
    v: float  # speed, m/s
    w: float  # warmth, A^2
    s: float  # position sensor before delay and noise, m


class Constants(NamedTuple):
    """The constants of the equations, from rig and effects; SI units."""

    mass: float
    travel: float
    weight: float
    K_c: float
    gap_bottom: float  # gap at x = 0, effects included
    gap_mid: float  # gap at mid-travel of the rig itself, anchor of exponent and emf
    K_A: float
    T_A: float
    b: float
    restitution: float
    current_max: float
    gain_loss: float
    heating_time: float
    slew: float
    dead_zone: float
    current_offset: float
    inductance_growth: float
    emf: float
    exponent: float
    inverse_saturation: float  # 1/i_s, 0 without saturation
    residual: float
    eddy: float
    drag2: float
    friction: float
    force: float
    shake: float
    shake_omega: float
    x_offset: float
    x_gain: float
    x_bow: float
    x_lag: float
    crosstalk: float
    input_delay: int  # steps
    magnet: float  # current of the permanent magnet, A; 0: a ball


def _compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` compiled by numba and cached; without numba, unchanged: same results, much slower."""
    try:
        numba = _numba()
    except ImportError:
        return function
    config = numba.config
    default_folder, config.CACHE_DIR = config.CACHE_DIR, _cache_folder()  # read while it decorates
    try:
        return cast("Callable[P, R]", numba.njit(cache=True)(function))
    except RuntimeError:  # no directory that a cache could be written to
        return cast("Callable[P, R]", numba.njit(function))
    finally:
        config.CACHE_DIR = default_folder


@cache
def _numba() -> Any:
    """Import numba without the linear algebra of scipy, which no function here calls: it would take 16 MB of each rig.

    Raises:
        ImportError: numba is not installed.
    """
    name = "scipy.linalg.cython_blas"
    is_there = name in sys.modules
    if not is_there:
        sys.modules[name] = cast(Any, None)  # an import of it now fails, and numba goes on without it
    try:
        import numba.np.arraymath
    finally:
        if not is_there:
            del sys.modules[name]
    return numba


@cache
def _cache_folder() -> str:
    """Return the cache folder for the machine code of this version of the file.

    numba cannot read machine code that names a class by its former name, so each version has a folder.
    """
    file = Path(__file__)
    parent = os.environ.get("NUMBA_CACHE_DIR") or file.parent / "__pycache__"
    return str(Path(parent) / f"plant-{hashlib.sha256(file.read_bytes()).hexdigest()[:16]}")


@_compiled
def reading(x: float, i: float, c: Constants) -> float:
    """Return the static reading of the position sensor, m: nonlinearity, gain, offset, crosstalk."""
    fraction = x / c.travel
    return c.x_gain * (x + 4.0 * c.x_bow * fraction * (1.0 - fraction)) + c.x_offset + c.crosstalk * i


@_compiled
def pull(y: PlantState, t: float, c: Constants) -> float:
    """Return the force on the ball without dry friction, N: magnetic (3), weight (4), drag (5), disturbances."""
    field = y.f + c.residual
    if c.inverse_saturation > 0.0:
        field /= math.sqrt(1.0 + (field * c.inverse_saturation) ** 2)
    gap = c.gap_bottom - y.x
    magnetic = c.K_c * field * (c.magnet if c.magnet > 0.0 else field) / (gap * gap)
    if c.exponent != 2.0:
        magnetic *= (c.gap_mid / gap) ** (c.exponent - 2.0)
    force = magnetic - c.weight - (c.b + c.drag2 * abs(y.v)) * y.v + c.force
    if c.shake != 0.0:
        force += c.shake * math.sin(c.shake_omega * t)
    return force


@_compiled
def _rates(y: PlantState, t: float, u: float, free: bool, direction: float, c: Constants) -> PlantState:
    """Return the time derivative of the state; `direction` stays the same in a step, so that dry friction is smooth."""
    target = c.K_A * (1.0 - c.gain_loss * y.w) * max(u - c.dead_zone, 0.0) + c.current_offset
    target = min(max(target, 0.0), c.current_max)
    gap = c.gap_bottom - y.x
    T_A = c.T_A
    if c.inductance_growth != 0.0:
        gap_top = c.gap_bottom - c.travel
        T_A *= 1.0 + c.inductance_growth * (1.0 / gap - 1.0 / c.gap_bottom) / (1.0 / gap_top - 1.0 / c.gap_bottom)
    drive = target - y.i
    if c.emf != 0.0:
        drive -= c.emf * y.i * y.v * (c.gap_mid / gap) ** 2
    di = min(max(drive / T_A, -c.slew), c.slew)
    # The target is limited already, but the induced voltage of a falling ball could drive the current beyond it.
    if y.i >= c.current_max:
        di = min(di, 0.0)
    df = (y.i - y.f) / c.eddy if c.eddy > 0.0 else di
    dx = y.v if free else 0.0
    dv = (pull(y, t, c) - direction * c.friction) / c.mass if free else 0.0
    dw = (y.i * y.i - y.w) / c.heating_time
    ds = (reading(y.x, y.i, c) - y.s) / c.x_lag if c.x_lag > 0.0 else 0.0
    return PlantState(di, df, dx, dv, dw, ds)


@_compiled
def _advanced(y: PlantState, k: PlantState, h: float) -> PlantState:
    return PlantState(y.i + h * k.i, y.f + h * k.f, y.x + h * k.x, y.v + h * k.v, y.w + h * k.w, y.s + h * k.s)


@_compiled
def _runge_kutta(y: PlantState, t: float, h: float, u: float, free: bool, direction: float, c: Constants) -> PlantState:
    k1 = _rates(y, t, u, free, direction, c)
    k2 = _rates(_advanced(y, k1, 0.5 * h), t + 0.5 * h, u, free, direction, c)
    k3 = _rates(_advanced(y, k2, 0.5 * h), t + 0.5 * h, u, free, direction, c)
    k4 = _rates(_advanced(y, k3, h), t + h, u, free, direction, c)
    z = _advanced(_advanced(_advanced(_advanced(y, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    f = z.f if c.eddy > 0.0 else z.i
    s = z.s if c.x_lag > 0.0 else reading(z.x, z.i, c)
    return PlantState(z.i, f, z.x, z.v, z.w, s)


@_compiled
def _event(y: PlantState, direction: float, c: Constants) -> bool:
    """Return whether the ball has passed a stop, or its motion has reversed under dry friction."""
    return y.x < 0.0 or y.x > c.travel or (c.friction > 0.0 and y.v * direction < 0.0)


@_compiled
def _land(y: PlantState, c: Constants) -> PlantState:
    """Return the state just after an event: on the stop with the speed reversed, or at rest."""
    x, v = y.x, y.v
    if x < 0.0 or x > c.travel:
        outward = -1.0 if x < 0.0 else 1.0
        x = min(max(x, 0.0), c.travel)
        if v * outward > 0.0:
            v = -c.restitution * v
        if abs(v) < REST_SPEED_M_S:
            v = 0.0
    else:
        v = 0.0
    s = y.s if c.x_lag > 0.0 else reading(x, y.i, c)
    return PlantState(y.i, y.f, x, v, y.w, s)


@_compiled
def _sign(value: float) -> float:
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


@_compiled
def step(y: PlantState, t: float, h: float, u: float, c: Constants) -> PlantState:
    """Integrate one step of length h with the input u held, including stops and dry friction."""
    for _ in range(_EVENTS_PER_STEP):
        direction = _sign(y.v)
        free = True
        # At rest the force decides, not the speed: a ball stays as long as it is pressed to its stop or held by
        # friction.
        if y.v == 0.0:
            force = pull(y, t, c)
            pressed = (y.x <= 0.0 and force <= 0.0) or (y.x >= c.travel and force >= 0.0)
            stuck = c.friction > 0.0 and abs(force) <= c.friction
            free = not (pressed or stuck)
            direction = _sign(force)
        z = _runge_kutta(y, t, h, u, free, direction, c)
        if not (free and _event(z, direction, c)):
            return z
        start, end = 0.0, h
        # Bisection, as an event is a yes or no here: it needs no slope, and always ends after the same number of steps.
        for _ in range(_BISECTIONS):
            middle = 0.5 * (start + end)
            if _event(_runge_kutta(y, t, middle, u, free, direction, c), direction, c):
                end = middle
            else:
                start = middle
        # The later end of the bracket: at the earlier one the stop is not passed yet, and `_land` would take it for a
        # reversal.
        y = _land(_runge_kutta(y, t, end, u, free, direction, c), c)
        t += end
        h -= end
        if h <= 0.0:
            return y
    # More events than a step can have: the ball is held for what is left of it, rather than moved through a stop.
    return _runge_kutta(y, t, h, u, False, 0.0, c)


@_compiled
def advance(
    state: Packed,
    first: int,
    count: int,
    h: float,
    u: float,
    constants: Packed,
    inputs: FloatArray,
    sensed: FloatArray,
) -> Packed:
    """Integrate `count` steps with the input u held from step number `first` on.

    Args:
        state: tuple(PlantState) at the start of step `first`.
        first: Steps done since time 0.
        count: Steps to do.
        h: Step, s.
        u: Input, V, already within the amplifier's range.
        constants: tuple(Constants).
        inputs: Ring of past inputs in V, shape (n,), entry k mod n belongs to step k; n > input_delay.  Updated.
        sensed: Ring of sensor outputs before noise, shape (n, 2): i_c in A, x in m after step k - 1.  Updated.

    Returns:
        tuple(PlantState) after the last step.
    """
    y, c, n = PlantState(*state), Constants(*constants), inputs.shape[0]
    for k in range(first, first + count):
        inputs[k % n] = u
        # k h, not a running sum: its rounding would depend on how a span is cut into calls.
        y = step(y, k * h, h, float(inputs[(k - c.input_delay) % n]), c)
        sensed[(k + 1) % n, 0] = y.i
        sensed[(k + 1) % n, 1] = y.s
    return y.i, y.f, y.x, y.v, y.w, y.s
