"""The extended model: the paper's (1) and (6) with all causes of the catalogue.

    u_c --delay, dead zone--> target --limits, T_A(x), emf--> i --lag, loop, remanence, saturation--> force --> x', x
    i, x --gain, offset, bow, crosstalk, lag--> sensor readings

The state y has shape (STATES,): i_c (A), x (m), x' (m/s), field current f (A), position sensor s (m), warmth w (A^2),
rate of the sensor s' (m/s), place of the iron on its loop (-1 to 1), share of the current with a second time constant
(A), field of a solid core (A), current sensor (A).  Then follows how far each of `OFFSETS` has wandered, in its unit;
the caller adds it to c.  Then comes the coloured noise of the readings of i_c (A) and x (m), and last their lines, a
pair for each harmonic.  The caller advances these and adds them to the readings.

Rule: with `catalogue.neutral()` the model is exactly (1) and (6), and f = i_c, s = x.  `integration.py` advances it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import inlined, kernel
from twin.model.causes import (
    air_gap_offset,
    amplifier_dead_zone,
    amplifier_gain_drift,
    amplifier_offset,
    constant_force,
    core_saturation,
    coulomb_friction,
    current_limit,
    current_sensor_gain,
    current_sensor_lag,
    current_sensor_offset,
    curve,
    eddy_current_lag,
    force_exponent,
    freewheel_diode,
    magnetic_hysteresis,
    motional_emf,
    periodic_disturbance,
    position_dependent_inductance,
    position_sensor_gain,
    position_sensor_lag,
    position_sensor_nonlinearity,
    position_sensor_offset,
    quadratic_drag,
    residual_magnetism,
    second_time_constant,
    sensor_crosstalk,
    slew_rate_limit,
)
from twin.model.causes.catalogue import OFFSETS
from twin.model.causes.cause import Vector
from twin.model.causes.sensor_line import HARMONICS

I_C, X, V, FIELD, SENSOR, WARMTH, RATE, LOOP, SECOND, CORE, I_SENSOR = range(11)
WANDER = 11  # of the first of `OFFSETS`
I_COLOUR, X_COLOUR = WANDER + len(OFFSETS), WANDER + len(OFFSETS) + 1
I_LINES = X_COLOUR + 1
X_LINES = I_LINES + 2 * HARMONICS
STATES = X_LINES + 2 * HARMONICS
INSTANT_S = 1e-9  # a shorter interval is a rounding error
GAP_MIN_SHARE = 0.01  # of the travel: smallest gap at which (3) is evaluated


class Base(NamedTuple):
    """The paper's parameters and the plant's constants; the kernels take tuple(Base)."""

    K_A: float  # A/V
    T_A: float  # s
    K_c: float  # N m^2/A^2
    b: float  # N s/m
    mass_kg: float
    gravity_m_s2: float
    x_max_m: float
    travel_m: float


@inlined
def drive(p: Base, c: Vector, u: float, w: float) -> float:
    """Return the steady-state current of the amplifier under u_c = u, A: K_A u of (1) with the amplifier's causes."""
    target = p.K_A * amplifier_gain_drift.gain(c, w) * amplifier_dead_zone.effective_input(c, u)
    if c[curve.DRIVE_OVER_U + 1] > c[curve.DRIVE_OVER_U]:
        target += mid_current(p) * curve.value(c, curve.DRIVE_OVER_U, u)
    return current_limit.aimed_at(c, amplifier_offset.shifted(c, target))


@inlined
def mid_current(p: Base) -> float:
    """The current that holds the ball in the middle of the travel by (6), A: i_0 of the curves."""
    return math.sqrt(p.mass_kg * p.gravity_m_s2 / p.K_c) * (p.x_max_m - 0.5 * p.travel_m)


@inlined
def square_of_current(c: Vector, field: float, bent: bool = True) -> float:
    """Return the factor of F_m that depends on the current alone, A^2: i_c^2 of (3) and its causes.

    `bent`: whether some cause of `is_bent` acts.
    """
    i = residual_magnetism.field(c, field)
    if not bent:
        return i * i
    i = core_saturation.field(c, i)
    return i * i * (1.0 + curve.value(c, curve.PULL_OVER_I, field))


@inlined
def field_after(
    c: Vector, f: float, core: float, z: float, i: float, i_next: float, w: float, w_next: float, h: float
) -> tuple[float, float, float, float]:
    """Return (field current f, that of the core, place on the loop, field that the ball feels) after h s.

    The current goes from i to i_next, A, and its weight (`eddy_current_lag.weight`) from w to w_next.
    """
    before = eddy_current_lag.mixed(c, f, core)
    f = eddy_current_lag.lagged(c, f, i, i_next, w, w_next, h)
    core = eddy_current_lag.slow(c, core, i, i_next, h)
    mixed = eddy_current_lag.mixed(c, f, core)
    z = magnetic_hysteresis.turned(c, z, before, mixed)
    return f, core, z, magnetic_hysteresis.field(c, mixed, z)


@inlined
def pull_per_square(p: Base, c: Vector, x: float, bent: bool = True) -> float:
    """Return F_m over mass and `square_of_current`, m/(s^2 A^2), which depends on the position alone."""
    # (3) is singular at the coil: nearer than that the gap is held, or one substep could give any speed.
    gap = max(air_gap_offset.gap_m(c, p.x_max_m - x), GAP_MIN_SHARE * p.travel_m)
    pull = p.K_c / (p.mass_kg * gap * gap)
    if not bent:
        return pull
    factor = force_exponent.factor(c, gap, p.x_max_m - 0.5 * p.travel_m)
    return pull * factor * (1.0 + curve.value(c, curve.PULL_OVER_X, x))


@inlined
def magnetic_force(p: Base, c: Vector, field: float, x: float, bent: bool = True) -> float:
    """Return F_m of (3), N; `bent`: whether some cause of `is_bent` acts."""
    return square_of_current(c, field, bent) * pull_per_square(p, c, x, bent) * p.mass_kg


@inlined
def rest_of_acceleration(p: Base, c: Vector, x: float, v: float, t: float, bent: bool = True) -> float:
    """Return x'' of (6) without magnetic force and dry friction, m/s^2; `bent` as in `magnetic_force`."""
    force, weights = constant_force.force_n(c) - p.b * v, -1.0
    if bent:
        force += periodic_disturbance.force_n(c, t) - quadratic_drag.drag_n(c, v)
        weights += curve.value(c, curve.FORCE_OVER_X, x) + curve.value(c, curve.FORCE_OVER_V, v)
        weights -= curve.value(c, curve.DRAG_OVER_X, x) * v / curve.DRAG_AT_M_S
    # (6) over the mass; the curves of the remainder are shares of the weight.
    return force * (1.0 / p.mass_kg) + p.gravity_m_s2 * weights


@inlined
def acceleration(p: Base, c: Vector, field: float, x: float, v: float, t: float, bent: bool = True) -> float:
    """Return x'' of (6) away from the stops and from a guide that rubs, m/s^2; `bent` as in `magnetic_force`."""
    return square_of_current(c, field, bent) * pull_per_square(p, c, x, bent) + rest_of_acceleration(
        p, c, x, v, t, bent
    )


@inlined
def position_reading(p: Base, c: Vector, x: float, i: float) -> float:
    """Return the steady-state reading of the position sensor, m."""
    bent = position_sensor_nonlinearity.bent(c, x, p.travel_m) + p.travel_m * curve.value(c, curve.SENSOR_OVER_X, x)
    shifted = position_sensor_offset.shifted(c, position_sensor_gain.scaled(c, bent))
    return sensor_crosstalk.disturbed(c, shifted, i)


@inlined
def lasting_warmth(c: Vector, i: float) -> float:
    """Return the warmth of a coil that has carried i, A, for a long time, A^2."""
    return amplifier_gain_drift.load(c, i)


@inlined
def settle_current(c: Vector, y: NDArray[np.float64], i: float) -> None:
    """Set the current of the coil to i, A, and all states that follow it, warmth included, to their steady state."""
    y[I_C], y[FIELD], y[SECOND], y[CORE], y[I_SENSOR] = i, i, i, i, i
    y[WARMTH] = lasting_warmth(c, i)


@inlined
def sensor_lag_s(c: Vector) -> float:
    """The time constant of the position sensor, s; 0 for an instantaneous sensor."""
    return c[position_sensor_lag.TAU]


@inlined
def lagging_reading(c: Vector, s: float, rate: float, steady: float, h: float) -> tuple[float, float]:
    """Return (sensor output in m, its rate in m/s) after h s from s and rate, with the steady state `steady`, m."""
    return position_sensor_lag.lagged(c, s, rate, steady, steady, steady, h)


@inlined
def reading_of_current(c: Vector, y: NDArray[np.float64]) -> float:
    """Return the reading of the current sensor in the state y, A."""
    return current_reading(c, current_sensor_lag.shown(c, y[I_SENSOR], y[I_C]))


@inlined
def current_reading(c: Vector, i: float) -> float:
    """Return the steady-state reading of the current sensor, A."""
    bent = i * (1.0 + curve.value(c, curve.READING_OVER_I, i))
    return current_sensor_offset.shifted(c, current_sensor_gain.scaled(c, bent))


@inlined
def current_of_reading(c: Vector, reading: float) -> float:
    """The current that gives this reading, A."""
    bent = (reading - c[current_sensor_offset.OFFSET]) / c[current_sensor_gain.GAIN]
    i = bent
    # Newton's method, as in `position_of_reading`.
    for _ in range(4):
        share, slope = curve.value(c, curve.READING_OVER_I, i), curve.slope(c, curve.READING_OVER_I, i)
        i -= (i * (1.0 + share) - bent) / (1.0 + share + i * slope)
    return i


@inlined
def position_of_reading(p: Base, c: Vector, reading: float, i: float) -> float:
    """The position that gives this steady-state reading, m, by Newton's method on `position_reading`."""
    x = reading
    # Newton without a test for convergence: a reading is near its position, and four steps cost the same each tick.
    for _ in range(4):
        slope = position_sensor_nonlinearity.slope(c, x, p.travel_m)
        slope += p.travel_m * curve.slope(c, curve.SENSOR_OVER_X, x)
        x -= (position_reading(p, c, x, i) - reading) / (c[position_sensor_gain.GAIN] * slope)
    return x


@inlined
def induced_lead(p: Base, c: Vector, v: float, gap: float) -> float:
    """Return by which factor the voltage that a moving ball induces raises the resistance of the coil."""
    bottom, gap_mid = air_gap_offset.gap_m(c, p.x_max_m), p.x_max_m - 0.5 * p.travel_m
    per_speed = motional_emf.per_speed(c, gap, gap_mid)
    per_speed += position_dependent_inductance.per_speed(c, p.T_A, gap, bottom, gap_mid)
    return motional_emf.lead(per_speed * v)


@inlined
def relaxed(p: Base, c: Vector, i: float, target: float, u: float, T_A: float, h: float) -> float:
    """The current after h s on its way from i to a constant target, with slew rate, diode and limit, A."""
    # Three pieces: the diode's loss has three straight ranges, and the current passes each once.
    for _ in range(3):
        if h > 0.0:
            aim, tau, end = freewheel_diode.piece(c, u, i, p.K_A, T_A, target)
            after = slew_rate_limit.relaxed(c, i, aim, tau, h)
            leaves = (after - end) * (aim - i) > 0.0  # the range of this response; at rest this is not a number
            h = h - slew_rate_limit.time_to(c, i, end, aim, tau) if leaves else 0.0
            i = end if leaves else after
    return current_limit.limited(c, i)


@inlined
def driven(
    p: Base,
    c: Vector,
    i: float,
    target: float,
    u: float,
    T_A: float,
    v: float,
    a: float,
    gap: float,
    at: float,
    h: float,
) -> float:
    """The current after h s, starting from i; `at` is the time since the ball had v, a and `gap`, s."""
    if c[motional_emf.COUPLING] == 0.0 and c[position_dependent_inductance.VOLTAGE] == 0.0:
        return relaxed(p, c, i, target, u, T_A, h)
    target -= p.K_A * freewheel_diode.lost_v(c, u, i, p.K_A)
    # The ball's motion is extrapolated over the step: its own stages need the current first.
    begin = induced_lead(p, c, v + at * a, gap - at * v)
    end = induced_lead(p, c, v + (at + h) * a, gap - (at + h) * v)
    change = T_A * (end - begin) / h if h > INSTANT_S else 0.0
    last = motional_emf.steady_lead(end, change)
    if c[slew_rate_limit.RATE] < math.inf:
        return current_limit.limited(c, slew_rate_limit.relaxed(c, i, target / last, T_A / last, h))
    first = motional_emf.steady_lead(begin, change)
    # T_A i' + lead i = target: for a lead that goes straight, the exponent is exactly that with the mean lead.
    i_next = target / last + (i - target / first) * math.exp(-0.5 * h * (begin + end) / T_A)
    return current_limit.limited(c, i_next)


@inlined
def is_bent(c: Vector) -> bool:
    """Return whether a cause or a curve changes the shape of the force over current, height, speed or time."""
    curves = (
        c[curve.PULL_OVER_X + 1] > c[curve.PULL_OVER_X]
        or c[curve.PULL_OVER_I + 1] > c[curve.PULL_OVER_I]
        or c[curve.FORCE_OVER_X + 1] > c[curve.FORCE_OVER_X]
        or c[curve.FORCE_OVER_V + 1] > c[curve.FORCE_OVER_V]
        or c[curve.DRAG_OVER_X + 1] > c[curve.DRAG_OVER_X]
    )
    powers = c[force_exponent.N] != 2.0 or c[force_exponent.BEND] != 0.0 or c[force_exponent.CURL] != 0.0
    motion = c[quadratic_drag.C] != 0.0 or c[periodic_disturbance.AMPLITUDE] != 0.0
    return curves or powers or motion or not math.isinf(c[core_saturation.I_S])


@inlined
def shapes_current(c: Vector) -> bool:
    """Return whether the current follows its target otherwise than by one or two lags of constant time."""
    of_ball = c[position_dependent_inductance.GROWTH] != 0.0 or c[motional_emf.COUPLING] != 0.0
    return of_ball or c[slew_rate_limit.RATE] < math.inf or c[freewheel_diode.DROP] != 0.0


@inlined
def is_slow(c: Vector) -> bool:
    """Return whether a cause changes how current, force or sensors respond, or holds the ball."""
    current = shapes_current(c) or c[second_time_constant.SHARE] != 0.0
    force = c[eddy_current_lag.TAU] > 0.0 or c[magnetic_hysteresis.HALF_WIDTH] > 0.0
    sensors = c[position_sensor_lag.TAU] > 0.0 or c[current_sensor_lag.TAU] > 0.0
    return current or force or sensors or c[coulomb_friction.FORCE] != 0.0


@inlined
def feels_ball(c: Vector) -> bool:
    """Return whether the motion of the ball changes current or field, or a cause needs the ball at each substep."""
    current = c[position_dependent_inductance.GROWTH] != 0.0 or c[motional_emf.COUPLING] != 0.0
    field = c[eddy_current_lag.TAU] > 0.0 and c[eddy_current_lag.FLUX] != 0.0
    return current or field or c[position_sensor_lag.TAU] > 0.0 or c[coulomb_friction.FORCE] != 0.0


@inlined
def has_first_order_current(c: Vector) -> bool:
    """Return whether the current of a held ball responds as a first-order lag, which needs no integration."""
    straight = c[slew_rate_limit.RATE] == math.inf and c[position_dependent_inductance.GROWTH] == 0.0
    return straight and c[freewheel_diode.DROP] == 0.0 and c[second_time_constant.SHARE] == 0.0


@kernel
def held_current(p: Base, c: Vector, i: float, w: float, x: float, u: float, duration: float) -> float:
    """The current after `duration` s with the ball held, A: that of `over` for the same u_c, without the ball.

    Args:
        p: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        i: at the beginning, A.
        w: warmth, A^2.
        x: where the ball is, m.
        u: input after all delays, V.
        duration: s.
    """
    target = drive(p, c, u, w)
    if has_first_order_current(c):
        return target + (i - target) * math.exp(-duration / p.T_A)
    plane = air_gap_offset.gap_m(c, p.x_max_m)
    gap = max(plane - x, GAP_MIN_SHARE * p.travel_m)
    T_A = position_dependent_inductance.time_constant(c, p.T_A, gap, plane, p.x_max_m - 0.5 * p.travel_m)
    return relaxed(p, c, i, target, u, T_A, duration)
