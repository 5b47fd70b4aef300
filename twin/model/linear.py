"""Linearisation (14) of a model with causes about an equilibrium, and its discretisation (15) with delays as states.

The states are sensor readings, because these are what the board measures and feeds back.

Rule 1: (14) is the matrix logarithm of differences of `integration.advance` over a short time, so there is no second
        set of equations.
Rule 2: the first three states are the readings of i_c and x and the speed in the position sensor's scale.  The states
        that causes add follow (currents that lag behind the coil's, settled reading of `position-sensor-lag` and its
        rate).
Rule 3: warmth stays at its equilibrium value, as it changes over minutes.  A periodic force is left out.  So are
        dry friction, as its linearisation at rest is a ball that sticks, and the loop of the iron.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, logm

from twin.model.causes import (
    actuation_delay,
    amplifier_gain_drift,
    coulomb_friction,
    current_sensor_gain,
    current_sensor_lag,
    eddy_current_lag,
    magnetic_hysteresis,
    periodic_disturbance,
    position_sensor_lag,
    sampling_delay,
    second_time_constant,
)
from twin.model.causes.cause import Vector
from twin.model.equilibrium import at_rest
from twin.model.extended import (
    CORE,
    FIELD,
    I_C,
    I_SENSOR,
    RATE,
    SECOND,
    SENSOR,
    Base,
    V,
    X,
    current_reading,
    position_reading,
)
from twin.model.extension import base, vector
from twin.model.integration import FREE, advance
from twin.model.parameters import Model

LONGEST_S = 1e-4  # longest time of a difference; it is also at most each time constant, for the logarithm to be exact
# Steps of central differences.  The curvature of (3) makes errors of (delta / gap)^2, 1e-9 of a slope; rounding less.
_DELTA = dict.fromkeys((I_C, V, FIELD, RATE, SECOND, CORE, I_SENSOR), 1e-5) | {X: 1e-7, SENSOR: 1e-7}  # SI units
_DELTA_U = 1e-4  # V


def delay_s(model: Model) -> float:
    """Return the delay from u_c to the readings, s: the sum of both delays."""
    c = vector(model.causes)
    return float(c[actuation_delay.DELAY] + c[sampling_delay.DELAY])


def linearise(model: Model, x_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the Jacobians (14) of the model with causes, without delays, at the equilibrium with the reading `x_m`.

    Returns:
        A, shape (n, n), and B, shape (n, 1), for readings [i_c, x, x', ..] in A, m, m/s and u_c in V; NaN
        if there is no equilibrium.
    """
    return linearised(base(model), vector(model.causes), x_m)


def linearised(p: Base, c: NDArray[np.float64], x_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Linearise by (14), for parameters and causes in the form of the kernels; c has shape (PLACES,)."""
    c = c.copy()
    c[coulomb_friction.FORCE] = c[periodic_disturbance.AMPLITUDE] = c[magnetic_hysteresis.HALF_WIDTH] = 0.0
    eddy, lag = float(eddy_current_lag.quick(c)), float(c[position_sensor_lag.TAU])
    y0, u0 = at_rest(p, c, x_m, as_reading=True)
    lags = {FIELD: eddy, SENSOR: lag, SECOND: c[second_time_constant.TAU] * (c[second_time_constant.SHARE] != 0.0)}
    lags[I_SENSOR] = float(c[current_sensor_lag.TAU])
    lags[CORE] = eddy * c[eddy_current_lag.TIMES] * (c[eddy_current_lag.SLOW] > 0.0)
    # A state without a lag follows at once: it would be an eigenvalue of 0, which has no logarithm.
    places = [I_C, X, V, *(state for state, tau in lags.items() if tau > 0.0)]
    if lag > 0.0 and c[position_sensor_lag.SECOND] > 0.0:
        places.append(RATE)
    n = len(places)
    if not math.isfinite(u0):
        return np.full((n, n), np.nan), np.full((n, 1), np.nan)
    c[amplifier_gain_drift.TAU] = math.inf  # warmth stands still
    h = min([LONGEST_S, p.T_A, *(tau for tau in lags.values() if tau > 0.0)])

    def after(state: int, delta: float) -> NDArray[np.float64]:
        y, u = y0.copy(), u0
        if state < 0:
            u += delta
        else:
            y[state] += delta
            if state == I_C and eddy <= 0.0:
                y[FIELD] = y[I_C]
        advance(tuple(p), c, y, u, 0.0, h, FREE)
        return y[places]

    block = np.eye(n + 1)
    for column, state in enumerate(places):
        delta = _DELTA[state]
        # Central differences: in one-sided ones the curvature of the force would remain.
        block[:n, column] = (after(state, delta) - after(state, -delta)) / (2.0 * delta)
    block[:n, n] = (after(-1, _DELTA_U) - after(-1, -_DELTA_U)) / (2.0 * _DELTA_U)
    rates = _logarithm(block) / h
    change = _to_readings(p, c, y0, places)
    return change @ rates[:n, :n] @ np.linalg.inv(change), change @ rates[:n, n:]


def measured(
    p: Base, c: NDArray[np.float64], x_m: float, sample_time_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (15) for the readings of i_c and x and the speed, (3, 3) and (3, 1), without delays and sensor lag.

    Currents that lag behind the coil's, which are not measured, are assumed settled at the measured one.
    """
    c = c.copy()
    c[position_sensor_lag.TAU] = c[current_sensor_lag.TAU] = 0.0
    phi, gamma = discretised(*linearised(p, c, x_m), 0.0, sample_time_s)
    phi[:, 0] += phi[:, 3:].sum(axis=1) / c[current_sensor_gain.GAIN]
    return phi[:3, :3], gamma[:3]


def _logarithm(block: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithm of a matrix near identity; by eigenvectors if well-conditioned, as `logm` takes 50 ms."""
    values, vectors = np.linalg.eig(block)
    if np.linalg.cond(vectors) < 1e6:
        return np.asarray(np.real((vectors * np.log(values.astype(complex))) @ np.linalg.inv(vectors)))
    return np.asarray(np.real(logm(block)))


def _to_readings(p: Base, c: Vector, y0: NDArray[np.float64], places: list[int]) -> NDArray[np.float64]:
    """The matrix from deviations of the states `places` to deviations of the readings, shape (n, n)."""
    i, x = float(y0[I_C]), float(y0[X])
    slope_x = (position_reading(p, c, x + 1e-7, i) - position_reading(p, c, x - 1e-7, i)) / 2e-7
    slope_i = (position_reading(p, c, x, i + 1e-4) - position_reading(p, c, x, i - 1e-4)) / 2e-4
    readings = np.eye(len(places))
    readings[0, 0] = (current_reading(c, i + 1e-4) - current_reading(c, i - 1e-4)) / 2e-4
    position_row = np.zeros(len(places))
    position_row[0], position_row[1] = slope_i, slope_x
    # In the scale of the sensor, as the board's difference of two readings has it.
    readings[2, 2] = slope_x
    if SENSOR in places:
        row = places.index(SENSOR)
        readings[1], readings[row] = np.eye(len(places))[row], position_row
    else:
        readings[1] = position_row
    if I_SENSOR in places:
        row = places.index(I_SENSOR)
        readings[[0, row]] = readings[0, 0] * np.eye(len(places))[[row, 0]]
    return readings


def c2d(
    A: NDArray[np.float64], B: NDArray[np.float64], sample_time_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Discretise with a zero-order hold, (15): [[Phi, Gamma], [0, I]] = exp([[A, B], [0, 0]] T_s)."""
    n, inputs = B.shape
    block = np.zeros((n + inputs, n + inputs))
    block[:n, :n], block[:n, n:] = A, B
    # One exponential of both (C. F. Van Loan, 1978): the formula with inv(A) fails where A is singular.
    whole = expm(block * sample_time_s)
    return np.asarray(whole[:n, :n]), np.asarray(whole[:n, n:])


def discretised(
    A: NDArray[np.float64], B: NDArray[np.float64], delay_s: float, sample_time_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Discretise by (15) with u_c delayed by `delay_s`: past inputs are states, the hold is split for part of a tick.

    Args:
        A: shape (n, n).
        B: shape (n, 1).
        delay_s: s, 0 or more.
        sample_time_s: s.

    Returns:
        Phi and Gamma for the states of A followed by u(k-1), u(k-2), .. if there is a delay.
    """
    whole, part_s = divmod(delay_s, sample_time_s)
    held, n = int(whole), len(A)
    if not np.isfinite(A).all():
        return np.full((n + held + 1, n + held + 1), np.nan), np.full((n + held + 1, 1), np.nan)
    # The old input acts for part of a tick, the new one for the rest: exact, where a Pade approximation is not (K. J.
    # Astrom, B. Wittenmark, Computer-Controlled Systems, 1997, ch. 2).
    phi, new = c2d(A, B, sample_time_s - part_s)
    if delay_s == 0.0:
        return phi, new
    before, old = c2d(A, B, part_s)
    phi, old = phi @ before, phi @ old
    # Whole ticks are past inputs as states; the tick that is cut has two of them.
    taps = [new if age == held else old if age == held + 1 else np.zeros((n, 1)) for age in range(held + 2)]
    size = n + held + 1
    F, G = np.zeros((size, size)), np.zeros((size, 1))
    F[:n, :n] = phi
    F[:n, n:] = np.hstack(taps[1:])
    F[n + 1 :, n:-1] = np.eye(held)
    G[:n], G[n, 0] = taps[0], 1.0
    return F, G
