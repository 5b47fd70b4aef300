"""Prediction of the filter from sample n - 1 to n: state and covariance, in flight and with the ball held."""

from __future__ import annotations

import math

import numpy as np

from twin.compiled import inlined, kernel
from twin.estimation.ekf.lines import doubt_lines, slopes_of_lines, turn_state
from twin.estimation.ekf.memory import Floats, Memory, base_of, wandered
from twin.estimation.ekf.transition import moments, transit
from twin.estimation.propagate import (
    INPUT_DELTA_V,
    UNKNOWN_INPUT_V,
    HeldInput,
    copy,
    current_held,
    delay_s,
    input_over,
    propagate,
)
from twin.estimation.structures import Steps
from twin.model.causes import actuation_delay, amplifier_gain_drift, coulomb_friction, magnetic_hysteresis
from twin.model.causes.catalogue import OFFSETS
from twin.model.extended import (
    FIELD,
    I_C,
    I_COLOUR,
    LOOP,
    RATE,
    SENSOR,
    WARMTH,
    X_COLOUR,
    Base,
    V,
    X,
    has_first_order_current,
)
from twin.model.integration import FREE

# For the Jacobian; coloured noise needs none.
_DELTA = np.array([1e-5, 1e-8, 1e-5, 1e-5, 1e-8, 1e-4, 1e-5, 1e-4, 1e-5, 1e-5, 1e-5] + [1e-6] * len(OFFSETS))


@inlined
def advance(f: Memory, y: Floats, u: HeldInput, t: float, T_s: float, stops: bool) -> None:
    """Advance the state y over T_s in place, in closed form if the model has one; arguments as `propagate`."""
    fade(f, y, T_s)
    if not f.closed_form:
        wandered(f, y)
        propagate(base_of(f), f.c[:], y, u, t, T_s, stops)
        return
    p = Base(*base_of(f))
    if T_s != f.moments_s:
        moments(T_s, p.T_A, f.moments[:])
        f.moments_s = T_s
    i, x, v = transit(p, f.moments[:], T_s, y[I_C], y[X], y[V], u.after)
    if stops and not 0.0 <= x <= p.travel_m:
        x, v = min(max(x, 0.0), p.travel_m), 0.0
    y[I_C], y[X], y[V], y[FIELD], y[SENSOR], y[RATE] = i, x, v, i, x, v


@inlined
def remembered(tau_s: float, T_s: float) -> float:
    """The share of coloured noise that is left after T_s, s."""
    return math.exp(-T_s / tau_s) if tau_s > 0.0 else 0.0


@inlined
def fade(f: Memory, y: Floats, T_s: float) -> None:
    """Advance coloured noise and lines of the state y in place by T_s."""
    if f.i_colour >= 0:
        y[I_COLOUR] *= remembered(f.tau_i, T_s)
    if f.x_colour >= 0:
        y[X_COLOUR] *= remembered(f.tau_x, T_s)
    if f.lines_count > 0:
        turn_state(f, y, T_s)


@inlined
def slopes_of_colour(f: Memory, T_s: float) -> None:
    """Fill the rows and columns of F that belong to coloured noise and lines."""
    for k in range(f.coloured, f.lines):
        for j in range(f.m):
            f.F[k, j], f.F[j, k] = 0.0, 0.0
        f.F[k, k] = remembered(f.tau_i if k == f.i_colour else f.tau_x, T_s)
    if f.lines_count > 0:
        slopes_of_lines(f, T_s)


@inlined
def step_linearised(f: Memory, known: Steps, n: int, T_s: float) -> None:
    """The state at n by the step of a nearby model, to first order; `previous` of f has the state at n - 1."""
    fade(f, f.y, T_s)
    for row in range(f.coloured):
        total = known.before[n, row]
        for k in range(f.coloured):
            total += known.slopes[n, row, k] * (f.previous[f.places[k]] - known.after[n - 1, k])
        f.y[f.places[row]] = total
    if f.field < 0:
        f.y[FIELD] = f.y[I_C]


@inlined
def take_slopes(f: Memory, known: Steps, n: int) -> None:
    """Set F to the Jacobian of the step to n of a nearby model."""
    for row in range(f.m):
        for column in range(f.m):
            f.F[row, column] = known.slopes[n, row, column]


@kernel
def differences(f: Memory, u: HeldInput, t: float, T_s: float) -> None:
    """Fill F with the Jacobian of `advance`, at the state in `previous`; the other arguments as there."""
    # Differences of the step, not a variational equation: that would be a second copy of the physics, which each new
    # cause would have to extend.
    moved, back = f.moved[:], f.back[:]
    rubs = f.c[coulomb_friction.FORCE] != 0.0
    for column in range(f.coloured):
        a = f.places[column]
        delta = _DELTA[a]
        wide = rubs and a <= V  # dry friction is not smooth: the difference is as wide as the standard deviation
        if wide:
            delta = max(delta, math.sqrt(f.P[column, column]))
        copy(moved, f.previous[:])
        moved[a] += delta
        if a == I_C and f.field < 0:
            moved[FIELD] = moved[I_C]
        advance(f, moved, u, t, T_s, FREE)
        # To both sides, so that a ball that may or may not be held has half of the effect.
        if wide:
            copy(back, f.previous[:])
            back[a] -= delta
            if a == I_C and f.field < 0:
                back[FIELD] = back[I_C]
            advance(f, back, u, t, T_s, FREE)
            for row in range(f.coloured):
                f.F[row, column] = (moved[f.places[row]] - back[f.places[row]]) / (2.0 * delta)
        else:
            for row in range(f.coloured):
                f.F[row, column] = (moved[f.places[row]] - f.y[f.places[row]]) / delta
    slopes_of_colour(f, T_s)


@inlined
def carry(F: Floats, P: Floats, G: Floats, m: int) -> None:
    """Set P = F P F' in the first m rows and columns; G is a working array."""
    # With a constant the compiler unrolls the loops.
    if m == 3:
        _carry(F, P, G, 3)
    elif m == 4:
        _carry(F, P, G, 4)
    else:
        _carry(F, P, G, m)


@inlined
def _carry(F: Floats, P: Floats, G: Floats, m: int) -> None:
    for row in range(m):
        for column in range(m):
            total = 0.0
            for k in range(m):
                total += F[row, k] * P[k, column]
            G[row, column] = total
    for row in range(m):
        for column in range(row, m):
            total = 0.0
            for k in range(m):
                total += G[row, k] * F[column, k]
            P[row, column] = total
            P[column, row] = total


@inlined
def add_process_noise(f: Memory, T_s: float) -> None:
    """Add the process noise of an interval to the covariance."""
    P, a2 = f.P, f.q_a
    # The acceleration is white from tick to tick and constant within one, hence T^4 / 4 and T^3 / 2 (Y. Bar-Shalom, X.
    # R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 6).
    P[0, 0] += f.q_i * T_s
    P[1, 1] += 0.25 * a2 * T_s**4
    P[1, 2] += 0.5 * a2 * T_s**3
    P[2, 1] = P[1, 2]
    P[2, 2] += a2 * T_s**2
    wander_on(f, T_s)


@inlined
def add_jitter(f: Memory, inputs: Floats, n: int, T_s: float) -> None:
    """Add to the covariance what the inputs do by acting at other times than usual, in the interval to sample n."""
    if f.c[actuation_delay.JITTER] <= 0.0:
        return
    T_A, delay, reach = f.paper[1], delay_s(f.c), actuation_delay.reach_s(f.c)
    felt = f.F[2, 0] / (T_A * (1.0 - math.exp(-T_s / T_A)))  # speed of the ball by the area below i_c
    # The intervals before this one are taken to be as long: in one chain they are.
    for k in range(max(n - 2 - int((delay + reach) / T_s), f.first + 1), n):
        since, change = (n - k) * T_s - delay, f.paper[0] * (inputs[k] - inputs[k - 1])
        if abs(change) > 0.0 and -reach < since < T_s + reach:  # not where an input is unknown, either
            of_i, area, way_s = actuation_delay.disturbance(f.c, T_A, since, T_s)
            of_i, of_v = change * of_i, change * felt * area
            of_x = way_s * of_v
            f.P[0, 0] += of_i * of_i
            f.P[0, 1] += of_i * of_x
            f.P[0, 2] += of_i * of_v
            f.P[1, 1] += of_x * of_x
            f.P[1, 2] += of_x * of_v
            f.P[2, 2] += of_v * of_v
            f.P[1, 0], f.P[2, 0], f.P[2, 1] = f.P[0, 1], f.P[0, 2], f.P[1, 2]


@inlined
def wander_on(f: Memory, T_s: float) -> None:
    """Add to the covariance how far the offsets wander in an interval, and what is new in coloured noise."""
    for k in range(f.wandering, f.coloured):
        f.P[k, k] += f.q_w[k - f.wandering] * T_s
    if f.i_colour >= 0:
        left = remembered(f.tau_i, T_s)
        f.P[f.i_colour, f.i_colour] += (1.0 - left * left) * f.v_i
    if f.x_colour >= 0:
        left = remembered(f.tau_x, T_s)
        f.P[f.x_colour, f.x_colour] += (1.0 - left * left) * f.v_x
    if f.lines_count > 0:
        doubt_lines(f, T_s)


@kernel
def doubt_input(f: Memory, inputs: Floats, lost: int, n: int, t: float, T_s: float) -> None:
    """Add to the covariance the effect of the unknown u_c of the sample `lost`; other arguments as `input_over`."""
    wandered(f, f.previous)
    moved, change = f.moved[:], f.back[:]
    inputs[lost] += INPUT_DELTA_V
    copy(moved, f.previous[:])
    propagate(base_of(f), f.c[:], moved, input_over(f.c[:], inputs, n, f.first, T_s), t, T_s, FREE)
    inputs[lost] -= INPUT_DELTA_V
    for row in range(f.coloured):
        change[row] = UNKNOWN_INPUT_V * (moved[f.places[row]] - f.y[f.places[row]]) / INPUT_DELTA_V
    for row in range(f.coloured):
        for column in range(f.coloured):
            f.P[row, column] += change[row] * change[column]


@inlined
def predict_held(f: Memory, u: HeldInput, inputs: Floats, n: int, t: float, T_s: float, x: float, known: Steps) -> None:
    """Predict current, warmth and loop at sample n with the ball held at x, m.

    The other arguments are those of `propagate`; `known` as in `filter.filtered`.
    """
    wandered(f, f.y)
    y = f.y[:]
    y[X], y[V] = x, 0.0
    copy(f.previous, y)
    if known.after.shape[0] > 0:
        step_linearised(f, known, n, T_s)
        y[X], y[V] = x, 0.0
    else:
        _advance_held(f, y, u, t, T_s)
        fade(f, y, T_s)
    if f.reuses_gains:
        return
    if known.slopes.shape[0] > 0:
        take_slopes(f, known, n)
    else:
        _differences_held(f, u, t, T_s)
    slopes_of_colour(f, T_s)
    carry(f.F, f.P, f.G, f.m)
    f.P[0, 0] += f.q_i * T_s
    add_jitter(f, inputs, n, T_s)
    wander_on(f, T_s)


@inlined
def _has_single_current(f: Memory) -> bool:
    """Return whether no other current lags behind that of the coil."""
    return f.field < 0 and f.second < 0 and f.i_sensor < 0


@inlined
def _current_after(f: Memory, i: float, u: HeldInput, T_s: float) -> float:
    """The current of a held ball after T_s, A, from i; the other arguments as `propagate`."""
    if f.closed_form:
        target = f.paper[0] * u.after
        return float(target + (i - target) * math.exp(-T_s / f.paper[1]))
    return float(current_held(base_of(f), f.c[:], i, u, T_s, f.previous[WARMTH], f.previous[X]))


@inlined
def _advance_held(f: Memory, y: Floats, u: HeldInput, t: float, T_s: float) -> None:
    """Advance the state y of a held ball in place; arguments as `propagate`."""
    p, c = Base(*base_of(f)), f.c[:]
    # Without another lagging current, that of the coil has a closed form, at a tenth of the cost of the whole state.
    if _has_single_current(f):
        i, w = y[I_C], y[WARMTH]
        y[I_C] = _current_after(f, i, u, T_s)
        if f.warmth >= 0:
            rates = amplifier_gain_drift.warmth_rate(c, i, w) + amplifier_gain_drift.warmth_rate(c, y[I_C], w)
            y[WARMTH] += 0.5 * T_s * rates
        if f.loop >= 0:
            y[LOOP] = magnetic_hysteresis.turned(c, y[LOOP], i, y[I_C])
        return
    # A huge mass without gravity keeps the ball in place within the interval.
    held_base = (p.K_A, p.T_A, p.K_c, p.b, 1e12, 0.0, p.x_max_m, p.travel_m)
    rubs = c[coulomb_friction.FORCE]
    c[coulomb_friction.FORCE] = 0.0  # it needs short substeps and has no effect on a ball in place
    propagate(held_base, c, y, u, t, T_s, FREE)
    c[coulomb_friction.FORCE] = rubs


@inlined
def _differences_held(f: Memory, u: HeldInput, t: float, T_s: float) -> None:
    """Fill F with the Jacobian of `_advance_held`; arguments as there."""
    c, y, F, moved, base = f.c[:], f.y[:], f.F, f.moved[:], f.paper
    for row in range(f.m):
        for column in range(f.m):
            F[row, column] = 1.0 if row == column else 0.0
    if _has_single_current(f):
        if has_first_order_current(c):
            F[0, 0] = math.exp(-T_s / base[1])
        else:
            i = f.previous[I_C]
            F[0, 0] = (_current_after(f, i + _DELTA[I_C], u, T_s) - y[I_C]) / _DELTA[I_C]
    else:
        lagging = (0, f.second, f.core, f.i_sensor)
        for column in lagging:
            if column >= 0:
                a = f.places[column]
                copy(moved, f.previous[:])
                moved[a] += _DELTA[a]
                _advance_held(f, moved, u, t, T_s)
                for row in lagging:
                    if row >= 0:
                        F[row, column] = (moved[f.places[row]] - y[f.places[row]]) / _DELTA[a]
    if f.warmth >= 0:
        F[f.warmth, f.warmth] = math.exp(-T_s / c[amplifier_gain_drift.TAU])
        # The steady current falls with the warmth, and the coil's goes the share 1 - F_00 of the way to it.
        F[0, f.warmth] = -base[0] * c[amplifier_gain_drift.LOSS] * u.after * (1.0 - F[0, 0])
    if f.loop >= 0:
        i, z = f.previous[I_C], f.previous[LOOP]
        moved_loop = magnetic_hysteresis.turned(c, z + _DELTA[LOOP], i, y[I_C])
        F[f.loop, f.loop] = (moved_loop - magnetic_hysteresis.turned(c, z, i, y[I_C])) / _DELTA[LOOP]
