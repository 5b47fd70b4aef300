"""What a right model gets wrong N samples ahead: the noise floor that every report prints.

A prediction starts from the filter's estimate and goes on with the recorded u_c.  If the model is right its error has
the covariance of that estimate, P, carried on by the slopes of the steps between, and the reading's own noise:

    var = h (F_N .. F_1 P F_1' .. F_N' + what process noise adds on the way) h' + sigma_x^2

Rule 1: P, F and h are the filter's own, along the recorded motion, for exactly the samples that were predicted: lags,
        delays, offsets, limits, lost samples and dry friction need no equations of their own here.
Rule 2: the noise is the caller's.  Both reports ask what sensor noise alone leaves: process noise takes up what a
        model gets wrong, and a floor with it would forgive that.

Against recordings simulated with the true model, for each cause of the catalogue: within 1 % (dry friction too weak to
hold the ball 4 %, 40 ms ahead) beside the sampling error
(tests/twin/estimation/test_prediction_floor.py).  A linearisation at rest was off by up to a factor of two under dry
friction (with it in the slopes 2.8 too low, without it 2.1 too high),
by 30 % under a slew limit, by 10 % with one sample in ten lost and by 6 % under drag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.estimation.ekf import OUT_COLUMNS, RECORDS, run_along, states_in
from twin.model.causes import eddy_current_lag, position_sensor_lag
from twin.model.extended import I_C, STATES, Base, X, position_reading

TOLERANCE = 1.05  # of error over floor: what rounding and numbers fitted to finite data add to a right model


def floor_rmse(
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
    ahead: int,
    predicted: NDArray[np.bool_],
) -> float:
    """Root mean square of x_hat - x over the predicted samples, m, of a right model; NaN where it cannot be told.

    The first ten arguments are those of `run_extended`.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        noise: as the filter takes it.
        stops_m: as there.
        t: s, shape (n,).
        step: s, shape (n,).
        u: V, shape (n,).
        y_i: A, shape (n,).
        y_x: m, shape (n,).
        flags: shape (n,).
        ahead: samples, 1 or more.
        predicted: which samples have a prediction from `ahead` samples before, shape (n,).
    """
    n, m = len(u), states_in(c)
    slopes, spread = np.zeros((n, m, m)), np.empty((n, m, m))
    before, after = np.empty((n, STATES)), np.empty((n, STATES))
    out, unwanted = np.empty((n, OUT_COLUMNS)), np.empty((0, STATES))
    run_along(
        base, c, noise, stops_m, t, step, u, y_i, y_x, flags, out, unwanted, RECORDS, slopes, before, after, spread
    )
    variance = np.full(n, np.nan)
    _carry(base, c, noise, step, slopes, spread, before, ahead, predicted, variance)
    known = variance[np.isfinite(variance)]
    return float(np.sqrt(known.mean())) if len(known) else float("nan")


@kernel
def _carry(
    base: Packed,
    c: NDArray[np.float64],
    noise: tuple[float, float, float, float, float],
    step: NDArray[np.float64],
    slopes: NDArray[np.float64],
    spread: NDArray[np.float64],
    before: NDArray[np.float64],
    ahead: int,
    predicted: NDArray[np.bool_],
    variance: NDArray[np.float64],
) -> None:
    p = Base(*base)
    m = slopes.shape[1]
    lags = c[position_sensor_lag.TAU] > 0.0
    sensor = 4 if c[eddy_current_lag.TAU] > 0.0 else 3  # its place among the active states
    q_per_s, a2 = noise[2] ** 2 / noise[4], noise[3] ** 2
    P, G, h = np.zeros((m, m)), np.zeros((m, m)), np.zeros(m)
    for n in range(ahead, len(predicted)):
        if not predicted[n]:
            continue
        P[:, :] = spread[n - ahead]
        for k in range(n - ahead + 1, n + 1):
            F, T_s = slopes[k], step[k]
            for row in range(m):
                for column in range(m):
                    total = 0.0
                    for j in range(m):
                        total += F[row, j] * P[j, column]
                    G[row, column] = total
            for row in range(m):
                for column in range(m):
                    total = 0.0
                    for j in range(m):
                        total += G[row, j] * F[column, j]
                    P[row, column] = total
            P[0, 0] += q_per_s * T_s
            P[1, 1] += 0.25 * a2 * T_s**4
            P[1, 2] += 0.5 * a2 * T_s**3
            P[2, 1] = P[1, 2]
            P[2, 2] += a2 * T_s**2
        h[:] = 0.0
        if lags:
            h[sensor] = 1.0
        else:
            i, x = before[n, I_C], before[n, X]
            now = position_reading(p, c, x, i)
            h[0] = (position_reading(p, c, x, i + 1e-3) - now) / 1e-3
            h[1] = (position_reading(p, c, x + 1e-6, i) - now) / 1e-6
        variance[n] = noise[1] ** 2
        for row in range(m):
            for column in range(m):
                variance[n] += h[row] * P[row, column] * h[column]
