"""The noise floor: the error of a right model N samples ahead.

A prediction starts from the filter's estimate and uses the recorded u_c.  Under a right model its error has the
covariance P of that estimate, propagated by the steps' Jacobians, plus the reading's noise (S 7):

    var = h (F_N .. F_1 P F_1' .. F_N' + propagated process noise) h' + sigma_x^2

Rule 1: P, F and h are those of the filter along the recorded motion, for the same samples that were predicted.  So
        lags, delays, offsets, limits, lost samples and dry friction need no equations here.
Rule 2: the caller gives the noise.  Both reports use sensor noise alone, because process noise absorbs errors of the
        model, which a floor must not include.

For recordings simulated with the true model, the floor is right within 1 % and the sampling error for each cause of the
catalogue.  The exception is dry friction too weak to hold the ball: 4 %, 40 ms ahead
(tests/twin/estimation/test_prediction_floor.py).  A linearisation at rest is not enough.  It errs by up to a factor of
2.8 under dry friction and 30 % under a slew limit.  It errs by 10 % with one sample in ten lost and 6 % under drag.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import kernel
from twin.estimation.ekf.correct import position_slopes, variance
from twin.estimation.ekf.filter import filtered
from twin.estimation.ekf.memory import Memory, memory_for, wandered
from twin.estimation.ekf.predict import add_jitter, add_process_noise, carry, take_slopes
from twin.estimation.innovations import FOLLOWS
from twin.estimation.structures import Results, Samples, System

TOLERANCE = 1.05  # error over floor of a right model, with rounding and parameters fitted to finite data


def floor_rmse(system: System, samples: Samples, ahead: int, predicted: NDArray[np.bool_]) -> float:
    """Return the root mean square of x_hat - x of a right model over the predicted samples, m; NaN without any.

    Args:
        system: the model and the noise.
        samples: of the series.
        ahead: horizon N in samples, 1 or more.
        predicted: which samples have a prediction from `ahead` samples earlier, shape (n,).
    """
    variances = np.full(len(samples.u), np.nan)
    _carry(memory_for(system), samples, filtered(system, samples, spread=True, steps=True), ahead, predicted, variances)
    known = variances[np.isfinite(variances)]
    return float(np.sqrt(known.mean())) if len(known) else float("nan")


@kernel
def _carry(
    f: Memory,
    samples: Samples,
    results: Results,
    ahead: int,
    predicted: NDArray[np.bool_],
    variances: NDArray[np.float64],
) -> None:
    spread, steps, step, noise_ratio = results.spread, results.steps, samples.step, samples.noise_ratio
    for n in range(len(predicted)):
        if samples.flags[n] & FOLLOWS == 0:
            f.first = n
        if n < ahead or not predicted[n]:
            continue
        # (S 7) from each estimate anew.  One covariance of a ball at rest would err by up to a factor of 2.8 under dry
        # friction.
        for row in range(f.m):
            for k in range(f.m):
                f.P[row, k] = spread[n - ahead, row, k]
        for k in range(n - ahead + 1, n + 1):
            take_slopes(f, steps, k)
            carry(f.F, f.P, f.G, f.m)
            add_process_noise(f, step[k])
            add_jitter(f, samples.u, k, step[k])
        for k in range(f.m):
            f.y[f.places[k]] = steps.before[n, k]
        wandered(f, f.y)
        ratio = noise_ratio[n, 1] if noise_ratio.shape[0] > 0 else 1.0
        f.share_x = math.sqrt(ratio)
        position_slopes(f, f.y[:], f.h_x[:])
        variances[n] = variance(f, f.h_x[:], f.r_x * ratio)
