"""The extended model over an interval in flight: away from the stops and without a cause of `feels_ball`.

    x'' = s(f(t)) p(x) + r(x, x', t)

s is the square of the field current f with its causes, p the pull of (3) over it, r the rest of (6).  Neither current
nor field depends on the ball, so s is known beforehand.  It may change within a fraction of an interval, so its moments
over time are summed over short parts.  p and r change little within 2 ms: they are parabolas through start, middle and
end.

Runge-Kutta (`integration.py`) evaluates all three in each of 16 stages, one after the other.  Here s has 9 values and p
and r have 5.  The errors are about the same (tests/twin/model/test_flight.py).  Runge-Kutta remains for currents and
fields that depend on the ball, for a lagging position sensor, for dry friction and for the stops.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, inlined, kernel
from twin.model.causes import (
    amplifier_gain_drift,
    current_sensor_lag,
    eddy_current_lag,
    magnetic_hysteresis,
    second_time_constant,
)
from twin.model.causes.cause import Vector
from twin.model.extended import (
    CORE,
    FIELD,
    I_C,
    I_SENSOR,
    INSTANT_S,
    LOOP,
    RATE,
    SECOND,
    SENSOR,
    WARMTH,
    Base,
    V,
    X,
    drive,
    field_after,
    is_bent,
    is_slow,
    position_reading,
    pull_per_square,
    relaxed,
    rest_of_acceleration,
    shapes_current,
    square_of_current,
)
from twin.model.integration import PARTS, short, steps_in

_SINGLE_SWEEP_S = 1.2e-3  # in a shorter interval one sweep is as exact as two are in 2 ms


@kernel
def fly(
    base: Packed,
    c: Vector,
    y: NDArray[np.float64],
    before: float,
    change: float,
    u: float,
    t: float,
    duration: float,
) -> None:
    """Advance the state by `duration` s; u_c changes from `before` to `u`, both in V, after `change` s.

    The other arguments are those of `integration.advance`.
    """
    if duration < INSTANT_S:
        return
    steps = steps_in(duration)
    T_s = duration / steps
    for k in range(steps):
        begins_s, change_s = t + k * T_s, min(max(change - k * T_s, 0.0), T_s)
        # With constants the compiler removes the terms that are absent.
        if is_slow(c):
            if is_bent(c):
                _step(base, c, y, before, change_s, u, begins_s, T_s, True, True)
            else:
                _step(base, c, y, before, change_s, u, begins_s, T_s, False, True)
        elif is_bent(c):
            _step(base, c, y, before, change_s, u, begins_s, T_s, True, False)
        else:
            _step(base, c, y, before, change_s, u, begins_s, T_s, False, False)


@inlined
def _step(
    base: Packed,
    c: Vector,
    y: NDArray[np.float64],
    before: float,
    change: float,
    u: float,
    t: float,
    T_s: float,
    bent: bool,
    slow: bool,
) -> None:
    """Run `fly` over at most LONGEST_STEP_S with constants that say what acts: `is_bent`, `is_slow`."""
    p = Base(*base)
    i, x, v, w = y[I_C], y[X], y[V], y[WARMTH]
    f, core, z, second, sensed, felt = y[FIELD], y[CORE], y[LOOP], y[SECOND], y[I_SENSOR], i
    if slow:
        felt = magnetic_hysteresis.field(c, eddy_current_lag.mixed(c, f, core), z)
    pull_0, rest_0 = pull_per_square(p, c, x, bent), rest_of_acceleration(p, c, x, v, t, bent)
    square, load = square_of_current(c, felt, bent), amplifier_gain_drift.load(c, i)
    s_0, s_1, s_2, s_3, mean_load, at = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # moments over the time from 0 to 1
    for piece in range(2):
        length = change if piece == 0 else T_s - change
        if length < INSTANT_S:
            continue
        target = drive(p, c, before if piece == 0 else u, w)
        coarse, share = short(p, c, length), length / T_s
        first_decay = math.exp(-0.5 * length * (1.0 if coarse else PARTS[0]) / p.T_A)  # of the current in half a part
        decay = first_decay
        for part in range(1 if coarse else len(PARTS)):
            # By products: the parts are 1, 3, 4 and 8 sixteenths.
            if part == 1:
                decay *= first_decay * first_decay
            elif part > 1:
                decay *= first_decay if part == 2 else decay
            h = share if coarse else share * PARTS[part]
            half_s = 0.5 * h * T_s
            if slow:
                i_half, i_end, second = current_after(p, c, i, second, target, before if piece == 0 else u, half_s)
                f, core, z, felt_half = field_after(c, f, core, z, i, i_half, 1.0, 1.0, half_s)
                f, core, z, felt = field_after(c, f, core, z, i_half, i_end, 1.0, 1.0, half_s)
                sensed = current_sensor_lag.lagged(c, sensed, i, i_half, i_end, 2.0 * half_s)
            else:
                i_half = target + (i - target) * decay
                i_end = target + (i_half - target) * decay
                felt_half, felt = i_half, i_end
            i = i_end
            square_half, square_end = square_of_current(c, felt_half, bent), square_of_current(c, felt, bent)
            load_half, load_end = amplifier_gain_drift.load(c, i_half), amplifier_gain_drift.load(c, i)
            # T. Simpson's rule, for each moment.
            half, end = at + 0.5 * h, at + h
            first, middle, last = h / 6.0 * square, h / 1.5 * square_half, h / 6.0 * square_end
            s_0 += first + middle + last
            s_1 += at * first + half * middle + end * last
            s_2 += at * at * first + half * half * middle + end * end * last
            s_3 += at * at * at * first + half * half * half * middle + end * end * end * last
            mean_load += h / 6.0 * (load + 4.0 * load_half + load_end)
            square, load, at = square_end, load_end, end
    # First with p and r as they are at the start; then each sweep takes the path of the one before (E. Picard, 1890).
    v_end = v + T_s * (pull_0 * s_0 + rest_0)
    x_end = x + T_s * (v + T_s * (pull_0 * (s_0 - s_1) + 0.5 * rest_0))
    for _ in range(2 if T_s > _SINGLE_SWEEP_S else 1):
        # The middle of the cubic through both ends (C. Hermite).
        x_half = 0.5 * (x + x_end) + 0.125 * T_s * (v - v_end)
        v_half = 1.5 * (x_end - x) / T_s - 0.25 * (v + v_end)
        pull_half, pull_end = pull_per_square(p, c, x_half, bent), pull_per_square(p, c, x_end, bent)
        rest_half = rest_of_acceleration(p, c, x_half, v_half, t + 0.5 * T_s, bent)
        rest_end = rest_of_acceleration(p, c, x_end, v_end, t + T_s, bent)
        slope, bend = 4.0 * pull_half - 3.0 * pull_0 - pull_end, 2.0 * (pull_end - 2.0 * pull_half + pull_0)
        impulse = pull_0 * s_0 + slope * s_1 + bend * s_2
        moment = pull_0 * s_1 + slope * s_2 + bend * s_3
        v_end = v + T_s * (impulse + (rest_0 + 4.0 * rest_half + rest_end) / 6.0)
        x_end = x + T_s * (v + T_s * (impulse - moment + (rest_0 + 2.0 * rest_half) / 6.0))
    y[WARMTH] = w + T_s * (mean_load - w) / c[amplifier_gain_drift.TAU]
    y[I_C], y[X], y[V], y[FIELD] = i, x_end, v_end, i
    y[SENSOR], y[RATE], y[I_SENSOR] = position_reading(p, c, x_end, i), 0.0, i
    if slow:
        y[FIELD], y[CORE], y[LOOP], y[SECOND], y[I_SENSOR] = f, core, z, second, sensed


@inlined
def current_after(
    p: Base, c: Vector, i: float, second: float, target: float, u: float, half_s: float
) -> tuple[float, float, float]:
    """Return (i_c after half_s s, i_c and i_2 after twice that) on the way from i to a constant target, A."""
    shared = c[second_time_constant.SHARE] != 0.0
    if shapes_current(c):
        if shared:  # i_2 is that of the middle, as in `integration.py`
            end, middle = target, second_time_constant.settled(c, second, target, half_s)
            target += second_time_constant.pull(c, middle, target, p.T_A)
            second = second_time_constant.settled(c, second, end, 2.0 * half_s)
        i_half = relaxed(p, c, i, target, u, p.T_A, half_s)
        return i_half, relaxed(p, c, i_half, target, u, p.T_A, half_s), second
    if shared:
        i_half, second = second_time_constant.driven(c, i, second, target, p.T_A, half_s)
        i_end, second = second_time_constant.driven(c, i_half, second, target, p.T_A, half_s)
        return i_half, i_end, second
    decay = math.exp(-half_s / p.T_A)
    i_half = target + (i - target) * decay
    return i_half, target + (i_half - target) * decay, second
