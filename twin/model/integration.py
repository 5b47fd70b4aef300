"""The extended model over an interval: the ball by Runge-Kutta, amplifier and lags exactly, within a few substeps.

Rule 1: within a substep the amplifier is integrated exactly for any T_A and slew rate.  The ball is integrated by
        Runge-Kutta with the current at start, middle and end.  The first substep is short because the current changes
        fastest right after a change of u_c.  After 2 ms the error of x is below 60 nm, a hundredth of the sensor
        noise.  It is 0.2 um for jumps of 1 A with the coil's plane at the stop (tests/twin/model/test_simulate.py).
        The output of a lagging position sensor is as exact as x.
Rule 2: delays are applied by the caller, who chooses the u_c in force (twin/estimation/propagate.py).
Rule 3: stops are inelastic, as in `simulate.py`, and apply only if the caller asks for them.
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, inlined, kernel
from twin.model.causes import (
    air_gap_offset,
    amplifier_gain_drift,
    coulomb_friction,
    current_sensor_lag,
    eddy_current_lag,
    magnetic_hysteresis,
    position_dependent_inductance,
    position_sensor_lag,
    second_time_constant,
)
from twin.model.causes.cause import Vector
from twin.model.extended import (
    CORE,
    FIELD,
    GAP_MIN_SHARE,
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
    acceleration,
    drive,
    driven,
    field_after,
    is_bent,
    is_slow,
    position_reading,
    shapes_current,
)

PARTS = (0.0625, 0.1875, 0.25, 0.5)  # substeps of an interval, as shares of it
SHORT_S = 1e-4  # a shorter interval, as in a 25 kHz capture, is one substep
SLOW_SHARE = 0.25  # of T_A: a shorter interval is one substep, too; the error of x is below 60 nm for each cause
# numpy's, not Python's: numba compiles a function once more for each constant of Python's, and all that it calls.
STOPS, FREE = cast("bool", np.True_), cast("bool", np.False_)
LONGEST_STEP_S = 2e-3  # longest interval of one `advance`; the error bounds of rule 1 hold for it


@kernel
def advance(base: Packed, c: Vector, y: NDArray[np.float64], u: float, t: float, duration: float, stops: bool) -> None:
    """Advance the state by `duration` s under constant u_c = u; y is updated in place.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        y: the state, shape (STATES,).
        u: input after all delays, V.
        t: time at the beginning, s, for periodic causes.
        duration: s, at most LONGEST_STEP_S.
        stops: whether x is limited to 0 .. travel: `STOPS` or `FREE`.
    """
    if duration < INSTANT_S:  # rounding error of a delay of whole intervals
        return
    # With constants the compiler removes the terms that are absent: a step of the paper's model takes half the time.
    if is_slow(c):
        if is_bent(c):
            _substeps(base, c, y, u, t, duration, stops, True, True)
        else:
            _substeps(base, c, y, u, t, duration, stops, False, True)
    elif is_bent(c):
        _substeps(base, c, y, u, t, duration, stops, True, False)
    else:
        _substeps(base, c, y, u, t, duration, stops, False, False)


@inlined
def _substeps(
    base: Packed,
    c: Vector,
    y: NDArray[np.float64],
    u: float,
    t: float,
    duration: float,
    stops: bool,
    bent: bool,
    slow: bool,
) -> None:
    """Run `advance` with the constants `is_bent` and `is_slow`, which tell the compiler which terms are present."""
    p = Base(*base)
    plane = air_gap_offset.gap_m(c, p.x_max_m)
    gap_mid = p.x_max_m - 0.5 * p.travel_m
    shaped = slow and shapes_current(c)
    rubs = slow and c[coulomb_friction.FORCE] != 0.0
    shared = slow and c[second_time_constant.SHARE] != 0.0
    lags = slow and c[position_sensor_lag.TAU] > 0.0
    coarse = short(p, c, duration)
    first_decay = math.exp(-0.5 * duration * (1.0 if coarse else PARTS[0]) / p.T_A)  # of the current in half a substep
    half_decay = first_decay
    for part in range(1 if coarse else len(PARTS)):
        h = duration if coarse else duration * PARTS[part]
        i, x, v, f, s, z, second, core = y[I_C], y[X], y[V], y[FIELD], y[SENSOR], y[LOOP], y[SECOND], y[CORE]
        mixed = eddy_current_lag.mixed(c, f, core) if slow else f
        a1 = acceleration(p, c, magnetic_hysteresis.field(c, mixed, z) if slow else f, x, v, t, bent)
        free, brake, held = a1, 0.0, False
        if rubs:
            brake = coulomb_friction.brakes(c, p.mass_kg, v, free)
            held = brake == 0.0
            a1 = 0.0 if held else a1 - brake
        v2 = v + 0.5 * h * a1
        target = drive(p, c, u, y[WARMTH])
        gap, T_A = plane - x, p.T_A
        pressed = False
        if shaped:
            gap = max(gap, GAP_MIN_SHARE * p.travel_m)
            pressed = stops and v == 0.0 and (a1 < 0.0 if x <= 0.0 else x >= p.travel_m)
            # T_A at the middle of each half.  Taken at its beginning, it left i of a fast ball 7 mA off after 2 ms.
            T_A = position_dependent_inductance.time_constant(c, p.T_A, gap - 0.25 * h * v, plane, gap_mid)
            if shared:  # i_2 is that of the middle: it changes little within a substep
                end, middle = target, second_time_constant.settled(c, second, target, 0.5 * h)
                target += second_time_constant.pull(c, middle, target, T_A)
                second = second_time_constant.settled(c, second, end, h)
            i_half = driven(p, c, i, target, u, T_A, v, 0.0 if pressed else a1, gap, 0.0, 0.5 * h)
        elif shared:
            i_half, second = second_time_constant.driven(c, i, second, target, T_A, 0.5 * h)
        else:
            # By products: the parts are 1, 3, 4 and 8 sixteenths, and an exponential costs a fifth of a substep.
            if part == 1:
                half_decay *= first_decay * first_decay
            elif part > 1:
                half_decay *= first_decay if part == 2 else half_decay
            i_half = target + (i - target) * half_decay
        f_half, w_half, felt_half = i_half, 1.0, i_half
        if slow:
            w = eddy_current_lag.weight(c, plane - x, gap_mid)
            w_half = eddy_current_lag.weight(c, plane - x - 0.5 * h * v, gap_mid)
            f_half, core, z, felt_half = field_after(c, f, core, z, i, i_half, w, w_half, 0.5 * h)
        # The brake of the first stage in all of them: were its sign to follow v, the stages would disagree at a
        # standstill.
        a2 = 0.0 if held else acceleration(p, c, felt_half, x + 0.5 * h * v, v2, t + 0.5 * h, bent) - brake
        if shaped:
            later = gap if pressed else gap - 0.75 * h * v2
            T_A = position_dependent_inductance.time_constant(c, p.T_A, later, plane, gap_mid)
            i_next = driven(p, c, i_half, target, u, T_A, v, 0.0 if pressed else a2, gap, 0.5 * h, 0.5 * h)
        elif shared:
            i_next, second = second_time_constant.driven(c, i_half, second, target, T_A, 0.5 * h)
        else:
            i_next = target + (i_half - target) * half_decay
        f_next, felt_next = i_next, i_next
        if slow:
            w_next = eddy_current_lag.weight(c, plane - x - h * v2, gap_mid)
            f_next, core, z, felt_next = field_after(c, f_half, core, z, i_half, i_next, w_half, w_next, 0.5 * h)
        v3 = v + 0.5 * h * a2
        a3 = acceleration(p, c, felt_half, x + 0.5 * h * v2, v3, t + 0.5 * h, bent) - brake
        v4 = v + h * a3
        a4 = acceleration(p, c, felt_next, x + h * v3, v4, t + h, bent) - brake
        # Runge-Kutta of order 4 (W. Kutta, 1901) for (6) alone: (1) is solved exactly, as T_A may be far below the
        # substep.
        x_next = x + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v_next = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if held:
            after = acceleration(p, c, felt_next, x, 0.0, t + h, bent)
            v_next, path = coulomb_friction.let_go(coulomb_friction.static_friction(c, p.mass_kg), free, after, h)
            x_next = x + path
        # The ball stopped on the way, where friction changes its sign: the rest of the substep begins at rest.
        elif brake * v_next < 0.0:
            after = acceleration(p, c, felt_next, x, 0.0, t + h, bent)
            v_next, path = coulomb_friction.turned(abs(brake), v, v_next, x_next - x, free, after, h)
            x_next = x + path
        if stops and max(x + 0.5 * h * v2, x + h * v3) > p.travel_m:
            # The ball has arrived.  The pull so near to the coil makes the stages too fast for a drag to be integrated.
            x_next, v_next = p.travel_m, 0.0
        elif stops and x_next <= 0.0:
            x_next, v_next = 0.0, max(v_next, 0.0)
        elif stops and x_next >= p.travel_m:
            x_next, v_next = p.travel_m, min(v_next, 0.0)
        if slow:
            if lags:
                # The middle of the cubic through both ends (C. Hermite).
                x_half = 0.5 * (x + x_next) + 0.125 * h * (v - v_next)
                reading, reading_half = position_reading(p, c, x, i), position_reading(p, c, x_half, i_half)
                reading_next = position_reading(p, c, x_next, i_next)
                y[SENSOR], y[RATE] = position_sensor_lag.lagged(c, s, y[RATE], reading, reading_half, reading_next, h)
            y[SECOND], y[CORE] = second, core
            y[I_SENSOR] = current_sensor_lag.lagged(c, y[I_SENSOR], i, i_half, i_next, h)
        # Euler's rule is enough: the warmth changes over half a second or more.
        y[WARMTH] += h * amplifier_gain_drift.warmth_rate(c, i, y[WARMTH])
        y[I_C], y[X], y[V], y[FIELD], y[LOOP] = i_next, x_next, v_next, f_next, z
        t += h
    if not lags:
        y[SENSOR], y[RATE] = position_reading(p, c, y[X], y[I_C]), 0.0
    if not slow:
        y[I_SENSOR] = y[I_C]


@inlined
def short(p: Base, c: Vector, duration: float) -> bool:
    """Return whether an interval is one substep."""
    # Not where the instant of a standstill matters, nor where T_A would go straight through the interval.
    whole = c[coulomb_friction.FORCE] == 0.0 and c[position_dependent_inductance.GROWTH] == 0.0
    return duration < SHORT_S or (whole and duration < SLOW_SHARE * p.T_A)


@inlined
def steps_in(duration: float) -> int:
    """Return the number of steps of at most LONGEST_STEP_S; equal ones, as the longest sets the error."""
    # The 0.01 forgives a rounding error.
    return max(math.ceil(duration / LONGEST_STEP_S - 0.01), 1)


@inlined
def over(base: Packed, c: Vector, y: NDArray[np.float64], u: float, t: float, duration: float, stops: bool) -> None:
    """Run `advance` for any duration, in steps of at most LONGEST_STEP_S; the arguments are the same."""
    steps = steps_in(duration)
    for k in range(steps):
        advance(base, c, y, u, t + k * (duration / steps), duration / steps, stops)
