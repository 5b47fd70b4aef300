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

from twin.compiled import kernel
from twin.estimation.ekf.correct import position_slopes, variance
from twin.estimation.ekf.filter import filtered
from twin.estimation.ekf.memory import Memory, base_of, copy_square, memory_for
from twin.estimation.ekf.predict import add_process_noise, carry
from twin.estimation.structures import Results, Samples, System

TOLERANCE = 1.05  # of error over floor: what rounding and numbers fitted to finite data add to a right model


def floor_rmse(system: System, samples: Samples, ahead: int, predicted: NDArray[np.bool_]) -> float:
    """Root mean square of x_hat - x over the predicted samples, m, of a right model; NaN where it cannot be told.

    Args:
        system: the model and the noise.
        samples: of the series.
        ahead: samples, 1 or more.
        predicted: which samples have a prediction from `ahead` samples before, shape (n,).
    """
    variances = np.full(len(samples.u), np.nan)
    _carry(memory_for(system), samples, filtered(system, samples, spread=True, steps=True), ahead, predicted, variances)
    known = variances[np.isfinite(variances)]
    return float(np.sqrt(known.mean())) if len(known) else float("nan")


@kernel
def _carry(
    f: Memory,
    samples: Samples,
    along: Results,
    ahead: int,
    predicted: NDArray[np.bool_],
    variances: NDArray[np.float64],
) -> None:
    spread, steps, step, noise_ratio = along.spread, along.steps, samples.step, samples.noise_ratio
    for n in range(ahead, len(predicted)):
        if not predicted[n]:
            continue
        copy_square(f.P, spread[n - ahead], f.m)
        for k in range(n - ahead + 1, n + 1):
            copy_square(f.F, steps.slopes[k], f.m)
            carry(f.F, f.P, f.G, f.m)
            add_process_noise(f, step[k])
        position_slopes(base_of(f), f.c[:], steps.before[n], f.sensor, f.h_x[:])
        variances[n] = variance(f, f.h_x[:], f.r_x * noise_ratio[n, 1] if noise_ratio.shape[0] > 0 else f.r_x)
