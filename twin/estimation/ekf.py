"""Prediction errors of the extended model along a whole campaign: the criterion of the diagnosis.

The filter of `twin/estimation/innovations.py`, for the state of `twin/model/extended.py`: what is predicted comes from
the extended model alone, the sensitivities are its differences.

Rule 1: the flags are those of `innovations.py`, and RESTS_LOW, RESTS_HIGH: the ball lies at a stop, whose place is
        known.  There the position sensor is tested alone: its offset, scale and crosstalk show without any force.
        RESTS_UNSEEN: it lies beyond the range of its sensor, and i_c is that of a ball at rest.  LOST: in the row of
        a lost sample (`twin/diagnose/evidence/lost_rows.py`) nothing was read, and u_c from it on is unknown.
Rule 2: only the states that the causes at hand give a life of their own are in the covariance: with the paper's model
        three, so that a candidate costs what it needs.
Rule 3: the first reading that tells the speed of a flight corrects the state and is not counted as predicted.
Rule 4: warmth at the start of a recording is unknown, and the filter finds it.
Rule 5: the u_c of a lost sample is what brings the current to the next reading, within what noise leaves open.  The two
        readings of i_c behind it correct the state and are not counted as predicted, whatever delay the model has.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.estimation.innovations import FLIES, FOLLOWS, SPEED_STD_M_S, USE_I, USE_X
from twin.model.causes import (
    actuation_delay,
    amplifier_gain_drift,
    coulomb_friction,
    current_sensor_gain,
    eddy_current_lag,
    freewheel_diode,
    position_dependent_inductance,
    position_sensor_lag,
    sampling_delay,
    slew_rate_limit,
)
from twin.model.extended import (
    FIELD,
    I_C,
    SENSOR,
    SHORT_S,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    advance,
    current_of_reading,
    current_reading,
    drive,
    position_of_reading,
    position_reading,
)

RESTS_LOW, RESTS_HIGH, RESTS_UNSEEN, LOST = 16, 32, 64, 128
OUT_COLUMNS = 5  # nu_i, nu_x, S_ii, S_ix, S_xx; NaN where nothing was predicted
UNKNOWN_INPUTS = 2  # samples after a start whose u_c may not be in force yet; not a matter of the model at hand
_ACCELERATION_M_S2 = 15.0  # of a flight's beginning
ALONE, RECORDS, ALONG, NOISE_ALONG = 0, 1, 2, 3  # what a run does with the slopes of its steps
_UNKNOWN_INPUT_V = 1.0  # standard deviation of a lost u_c about the one before
_INPUT_DELTA_V = 1e-3
_ANSWERS = 0.02  # of K_A: what i_c must answer to u_c within the interval, to be asked for it
_WARMTH = (0.25, 0.3)  # A^2: of a recording's start, mean and standard deviation
_DELTA = np.array([1e-5, 1e-8, 1e-5, 1e-5, 1e-8, 1e-4])  # of the states, for differences


@kernel
def drive_over(
    base: Packed,
    c: NDArray[np.float64],
    y: NDArray[np.float64],
    u: NDArray[np.float64],
    n: int,
    first: int,
    t: float,
    T_s: float,
    stops: bool,
) -> None:
    """From sample n - 1 to n: the inputs in force, delays applied, one after the other.

    Args:
        base: tuple(Base).
        c: the causes' parameters.
        y: the state at n - 1, updated in place.
        u: u_c of each sample, V, shape (n_samples,).
        n: the sample that is reached.
        first: no earlier input is known than that of this sample.
        t: of n - 1, s.
        T_s: from n - 1 to n, s.
        stops: as in `advance`.
    """
    delay = c[actuation_delay.DELAY] + c[sampling_delay.DELAY]
    if delay <= 0.0:
        advance(base, c, y, u[n - 1], t, T_s, stops)
        return
    whole = int(delay / T_s)
    part = delay - whole * T_s
    advance(base, c, y, u[max(n - 2 - whole, first)], t, part, stops)
    advance(base, c, y, u[max(n - 1 - whole, first)], t + part, T_s - part, stops)


@kernel
def _find_input(
    base: Packed,
    c: NDArray[np.float64],
    here: NDArray[np.float64],
    u: NDArray[np.float64],
    lost: int,
    n: int,
    first: int,
    t: float,
    T_s: float,
    reading: float,
    trial: NDArray[np.float64],
) -> None:
    """Put into u[lost] what brings i_c from the state `here` at n - 1 to its reading at n; `trial`: room."""
    held = u[lost]
    for _ in range(3):
        trial[:] = here
        drive_over(base, c, trial, u, n, first, t, T_s, False)
        i_c = current_reading(c, trial[I_C])
        u[lost] += _INPUT_DELTA_V
        trial[:] = here
        drive_over(base, c, trial, u, n, first, t, T_s, False)
        u[lost] -= _INPUT_DELTA_V
        answer = (current_reading(c, trial[I_C]) - i_c) / _INPUT_DELTA_V
        if not answer > _ANSWERS * base[0]:
            return
        most = 5.0 * _UNKNOWN_INPUT_V
        u[lost] = min(max(u[lost] + (reading - i_c) / answer, held - most), held + most)


@kernel
def _settle(
    base: Packed, c: NDArray[np.float64], i: float, u: NDArray[np.float64], n: int, first: int, T_s: float, w: float
) -> float:
    """The current of a held ball at sample n, from i at n - 1, by (1) alone; the inputs in force as in `drive_over`."""
    p = Base(*base)
    delay = c[actuation_delay.DELAY] + c[sampling_delay.DELAY]
    whole = int(delay / T_s)
    part = delay - whole * T_s
    if part > 0.0:
        target = drive(p, c, u[max(n - 2 - whole, first)], w)
        i = target + (i - target) * math.exp(-part / p.T_A)
    target = drive(p, c, u[max(n - 1 - whole, first)], w)
    return target + (i - target) * math.exp(-(T_s - part) / p.T_A)


@kernel
def _clear(P: NDArray[np.float64], row: int) -> None:
    for k in range(P.shape[0]):
        P[row, k] = 0.0
        P[k, row] = 0.0


@kernel
def _gain(P: NDArray[np.float64], h: NDArray[np.float64], r: float, m: int, K: NDArray[np.float64]) -> float:
    """K = P h / s over the first m states; returns s = h' P h + r."""
    s = r
    for a in range(m):
        K[a] = 0.0
        for b in range(m):
            K[a] += P[a, b] * h[b]
    for a in range(m):
        s += h[a] * K[a]
    for a in range(m):
        K[a] /= s
    return s


@kernel
def _correct(P: NDArray[np.float64], K: NDArray[np.float64], s: float, m: int) -> None:
    for a in range(m):
        for b in range(a, m):
            P[a, b] -= K[a] * K[b] * s
            P[b, a] = P[a, b]


def states_in(c: NDArray[np.float64]) -> int:
    """How many states the causes leave active: m of `run_along`."""
    lives = c[amplifier_gain_drift.LOSS] != 0.0, c[eddy_current_lag.TAU] > 0.0, c[position_sensor_lag.TAU] > 0.0
    return 3 + sum(map(int, lives))


@kernel
def run_along(
    base: Packed,
    c: NDArray[np.float64],
    noise: tuple[float, float, float, float, float],
    stops_m: tuple[float, float],
    t: NDArray[np.float64],
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    y_i: NDArray[np.float64],
    y_x: NDArray[np.float64],
    flags: NDArray[np.uint8],
    out: NDArray[np.float64],
    state: NDArray[np.float64],
    mode: int,
    slopes: NDArray[np.float64],
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    spread: NDArray[np.float64],
) -> None:
    """`run_extended`, or one model along another: with the slopes of its steps, which are most of the work.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        noise: standard deviations (i_c in A, x in m, disturbance of i_c in A per tick, acceleration in m/s^2), and the
            length of that tick in s.
        stops_m: where the ball lies at the lower and at the upper stop, m.
        t: s, with the phase of periodic causes, shape (n,).
        step: time to the sample before, s, shape (n,).
        u: u_c from each sample on, V, shape (n,).
        y_i: measured i_c, A, shape (n,).
        y_x: measured x, m, shape (n,).
        flags: of each sample, shape (n,).
        out: receives nu_i, nu_x, S_ii, S_ix, S_xx.
        state: receives the state after the correction, shape (n, 6), NaN where the ball does not fly; shape (0, 6)
            where nobody wants it.
        mode: ALONE; RECORDS: fills the arrays that follow; ALONG: takes the slopes from there; NOISE_ALONG: the steps,
            too, for a model that differs in its noise alone.
        slopes: of each step in flight, shape (n, m, m) with m active states.
        before: the state at each sample before its correction, shape (n, 6).
        after: behind it, shape (n, 6).
        spread: receives the covariance of the active states after the correction, shape (n, m, m); shape (0, m, m)
            where nobody wants it.
    """
    p = Base(*base)
    r_i, r_x, q_per_s, a2 = noise[0] ** 2, noise[1] ** 2, noise[2] ** 2 / noise[4], noise[3] ** 2
    heats, eddies, lags = (
        c[amplifier_gain_drift.LOSS] != 0.0,
        c[eddy_current_lag.TAU] > 0.0,
        c[position_sensor_lag.TAU] > 0.0,
    )
    # active states: I_C, X, V first, as they are numbered
    active = np.zeros(STATES, np.int64)
    active[0], active[1], active[2] = I_C, X, V
    m = 3
    k_field, k_sensor, k_warm = -1, -1, -1
    if eddies:
        k_field, active[m] = m, FIELD
        m += 1
    if lags:
        k_sensor, active[m] = m, SENSOR
        m += 1
    if heats:
        k_warm, active[m] = m, WARMTH
        m += 1
    y, here, moved, back = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    rubs = c[coulomb_friction.FORCE] != 0.0
    # Whether the amplifier is (1), so that the current of a held ball needs no integration.
    linear = not (eddies or lags or heats) and c[slew_rate_limit.RATE] == math.inf
    linear = linear and c[position_dependent_inductance.GROWTH] == 0.0 and c[freewheel_diode.DROP] == 0.0
    P, F, G = np.zeros((m, m)), np.zeros((m, m)), np.zeros((m, m))
    h_i, h_x, K = np.zeros(m), np.zeros(m), np.zeros(m)
    gain_i = c[current_sensor_gain.GAIN]
    h_i[0] = gain_i
    # A ball that is held does not move within an interval either: the weight of a house, and no gravity.
    held_base = (p.K_A, p.T_A, p.K_c, p.b, 1e12, 0.0, p.x_max_m, p.travel_m)
    held_c = c.copy()
    held_c[coulomb_friction.FORCE] = 0.0  # it needs fine substeps, and holds nothing here
    in_flight, speed_seen = False, False
    delay = c[actuation_delay.DELAY] + c[sampling_delay.DELAY]
    inputs = u.copy()  # those of lost samples are found
    first = 0
    for n in range(len(u)):
        flag = flags[n]
        for column in range(5):
            out[n, column] = np.nan
        follows = flag & FOLLOWS != 0 and n > 0
        flies = flag & FLIES != 0
        use_i, use_x = flag & USE_I != 0, flag & USE_X != 0
        rests = flag & (RESTS_LOW | RESTS_HIGH) != 0
        if not follows:
            first = n
        if follows:
            T_s = step[n]
            q_i = q_per_s * T_s
            if in_flight and flies:
                for k in range(STATES):
                    here[k] = y[k]
                lost = n - 1 - int(delay / T_s)  # its input comes into force on the way here
                unknown = lost >= first and flags[lost] & LOST != 0
                if unknown and use_i:
                    _find_input(base, c, here, inputs, lost, n, first, t[n - 1], T_s, y_i[n], moved)
                if mode == NOISE_ALONG and not unknown:
                    for row in range(m):
                        total = before[n, active[row]]
                        for k in range(m):
                            total += slopes[n, row, k] * (here[active[k]] - after[n - 1, active[k]])
                        y[active[row]] = total
                    if not eddies:
                        y[FIELD] = y[I_C]
                else:
                    drive_over(base, c, y, inputs, n, first, t[n - 1], T_s, False)
                if mode >= ALONG:
                    F[:, :] = slopes[n]
                else:
                    for column in range(m):
                        for k in range(STATES):
                            moved[k] = here[k]
                        a = active[column]
                        delta = _DELTA[a]
                        if rubs and a <= V:
                            delta = max(delta, math.sqrt(P[column, column]))
                        moved[a] += delta
                        if a == I_C and not eddies:
                            moved[FIELD] = moved[I_C]
                        drive_over(base, c, moved, inputs, n, first, t[n - 1], T_s, False)
                        if rubs and a <= V:
                            for k in range(STATES):
                                back[k] = here[k]
                            back[a] -= delta
                            if a == I_C and not eddies:
                                back[FIELD] = back[I_C]
                            drive_over(base, c, back, inputs, n, first, t[n - 1], T_s, False)
                            for row in range(m):
                                F[row, column] = (moved[active[row]] - back[active[row]]) / (2.0 * delta)
                        else:
                            for row in range(m):
                                F[row, column] = (moved[active[row]] - y[active[row]]) / delta
                if mode == RECORDS:
                    slopes[n] = F
                    before[n] = y
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
                if unknown:
                    inputs[lost] += _INPUT_DELTA_V
                    moved[:] = here
                    drive_over(base, c, moved, inputs, n, first, t[n - 1], T_s, False)
                    inputs[lost] -= _INPUT_DELTA_V
                    for row in range(m):
                        K[row] = _UNKNOWN_INPUT_V * (moved[active[row]] - y[active[row]]) / _INPUT_DELTA_V
                    for row in range(m):
                        for column in range(m):
                            P[row, column] += K[row] * K[column]
                P[0, 0] += q_i
                P[1, 1] += 0.25 * a2 * T_s**4
                P[1, 2] += 0.5 * a2 * T_s**3
                P[2, 1] = P[1, 2]
                P[2, 2] += a2 * T_s**2
            else:
                # The ball is held: the current (and the warmth) alone.
                held = min(max(y_x[n - 1], 0.0), p.travel_m)
                for k in range(STATES):
                    moved[k] = y[k]
                y[X], y[V], moved[X], moved[V] = held, 0.0, held, 0.0
                if linear:
                    y[I_C] = _settle(base, c, y[I_C], inputs, n, first, T_s, y[WARMTH])
                    f_ii = math.exp(-T_s / p.T_A)
                else:
                    moved[I_C] += _DELTA[I_C]
                    drive_over(held_base, held_c, moved, inputs, n, first, t[n - 1], T_s, False)
                    drive_over(held_base, held_c, y, inputs, n, first, t[n - 1], T_s, False)
                    f_ii = (moved[I_C] - y[I_C]) / _DELTA[I_C]
                if heats:
                    f_iw = -p.K_A * c[amplifier_gain_drift.LOSS] * inputs[n - 1] * (1.0 - f_ii)
                    P[0, 0] = f_ii * f_ii * P[0, 0] + f_iw * f_iw * P[k_warm, k_warm]
                    P[0, 0] += 2.0 * f_ii * f_iw * P[0, k_warm]
                    P[0, k_warm] = f_ii * P[0, k_warm] + f_iw * P[k_warm, k_warm]
                    P[k_warm, 0] = P[0, k_warm]
                else:
                    P[0, 0] = f_ii * f_ii * P[0, 0]
                P[0, 0] += q_i
                in_flight = False
        else:
            in_flight = False

        blind = follows and not in_flight and flags[n - 1] & USE_I == 0
        if follows and use_i and step[n] > SHORT_S and (blind or n - first <= UNKNOWN_INPUTS):
            # Nobody recorded what was in force before the first sample, nor how the ball moved where i_c is not used:
            # the current is measured anew.
            _clear(P, 0)
            y[I_C], P[0, 0] = current_of_reading(c, y_i[n]), r_i / (gain_i * gain_i)
            use_i = False
        if not follows:
            _clear(P, 0)
            if use_i:
                y[I_C], P[0, 0] = current_of_reading(c, y_i[n]), r_i / (gain_i * gain_i)
            else:
                y[I_C], P[0, 0] = p.K_A * u[n], 1e2
            y[FIELD] = y[I_C]
            use_i = False
            if heats:
                _clear(P, k_warm)
                y[WARMTH], P[k_warm, k_warm] = _WARMTH[0], _WARMTH[1] ** 2
        if flies and not in_flight:
            if use_x:
                for k in range(m):
                    if k != 0 and k != k_warm:
                        _clear(P, k)
                y[X], y[V], in_flight = position_of_reading(p, c, y_x[n], y[I_C]), 0.0, True
                speed_seen = False
                y[SENSOR] = y_x[n]
                # A reading that shows the current, too, places the ball as well as the current is known.
                shown = (position_reading(p, c, y[X], y[I_C] + 1e-3) - position_reading(p, c, y[X], y[I_C])) / 1e-3
                P[1, 1], P[2, 2] = r_x + shown * shown * P[0, 0], SPEED_STD_M_S**2
                if eddies:
                    P[k_field, k_field] = P[0, 0]
                    P[0, k_field] = P[0, 0]
                    P[k_field, 0] = P[0, 0]
                for k in (0, k_field, k_warm):
                    if k >= 0:
                        P[1, k] = -shown * P[0, k]
                        P[k, 1] = P[1, k]
                if lags:
                    # The sensor lags a ball of unknown speed: where x is depends on it.
                    tau = c[position_sensor_lag.TAU]
                    P[1, 1] += (tau * SPEED_STD_M_S) ** 2 + (tau * tau * _ACCELERATION_M_S2) ** 2
                    P[1, k_sensor] = r_x
                    P[k_sensor, 1] = r_x
                    P[1, 2] = tau * SPEED_STD_M_S**2
                    P[2, 1] = P[1, 2]
                    P[k_sensor, k_sensor] = r_x
            use_x = False

        if use_i and in_flight and n - first > 1 and (flags[n - 1] | flags[n - 2]) & LOST != 0:
            s = _gain(P, h_i, r_i, m, K)
            n_i = y_i[n] - current_reading(c, y[I_C])
            for a in range(m):
                y[active[a]] += K[a] * n_i
            _correct(P, K, s, m)
            use_i = False
        n_i = y_i[n] - current_reading(c, y[I_C])
        if use_x and rests and not in_flight:
            stop = stops_m[0] if flag & RESTS_LOW != 0 else p.travel_m + stops_m[1]
            out[n, 1], out[n, 4] = y_x[n] - position_reading(p, c, stop, y[I_C]), r_x
            if use_i:
                out[n, 3] = 0.0
            use_x = False
        use_x = use_x and in_flight
        if use_x:
            for k in range(m):
                h_x[k] = 0.0
            if lags:
                h_x[k_sensor] = 1.0
                n_x = y_x[n] - y[SENSOR]
            else:
                now = position_reading(p, c, y[X], y[I_C])
                h_x[0] = (position_reading(p, c, y[X], y[I_C] + 1e-3) - now) / 1e-3
                h_x[1] = (position_reading(p, c, y[X] + 1e-6, y[I_C]) - now) / 1e-6
                n_x = y_x[n] - now
            s_ix = 0.0
            if use_i:
                for a in range(m):
                    s_ix += gain_i * P[0, a] * h_x[a]
                out[n, 3] = s_ix
            out[n, 1] = n_x
            s_xx = r_x
            for a in range(m):
                for b in range(m):
                    s_xx += h_x[a] * P[a, b] * h_x[b]
            out[n, 4] = s_xx
            if not speed_seen:
                # It tells how fast the ball was, which nobody predicted: a model with friction would predict it better
                # only because friction narrows any guess.
                out[n, 1], out[n, 3], out[n, 4] = np.nan, np.nan, np.nan
                speed_seen = True
        if use_i:
            s = _gain(P, h_i, r_i, m, K)
            out[n, 0], out[n, 2] = n_i, s
            if use_x:
                for a in range(m):
                    n_x -= h_x[a] * K[a] * n_i
            for a in range(m):
                if a == 0 or in_flight or a == k_warm:
                    y[active[a]] += K[a] * n_i
            _correct(P, K, s, m)
        if use_x:
            s = _gain(P, h_x, r_x, m, K)
            for a in range(m):
                y[active[a]] += K[a] * n_x
            _correct(P, K, s, m)
        if not eddies:
            y[FIELD] = y[I_C]
        if not lags:
            y[SENSOR] = position_reading(p, c, y[X], y[I_C])
        if mode == RECORDS:
            after[n] = y
        if spread.shape[0] > 0:
            spread[n] = P
        if state.shape[0] > 0:
            for k in range(STATES):
                state[n, k] = y[k] if in_flight else np.nan
        if not math.isfinite(y[X] + y[I_C] + y[V]):
            # The parameters are impossible: nothing sensible follows in this chain.
            in_flight = False
            for k in range(STATES):
                y[k] = 0.0
            for a in range(m):
                _clear(P, a)


@kernel
def run_extended(
    base: Packed,
    c: NDArray[np.float64],
    noise: tuple[float, float, float, float, float],
    stops_m: tuple[float, float],
    t: NDArray[np.float64],
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    y_i: NDArray[np.float64],
    y_x: NDArray[np.float64],
    flags: NDArray[np.uint8],
    out: NDArray[np.float64],
    state: NDArray[np.float64],
) -> None:
    """Fill out, shape (n, 5), with innovations and their covariance, and `state` with the corrected estimates.

    The arguments are those of `run_along`.
    """
    nothing, none = np.empty((0, STATES)), np.empty((0, 3, 3))
    run_along(base, c, noise, stops_m, t, step, u, y_i, y_x, flags, out, state, ALONE, none, nothing, nothing, none)
