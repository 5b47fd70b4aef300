"""The benefit of a cause for the prediction of x, on the recordings for fitting.

The likelihood weighs all readings alike.  If much of i_c is unexplained, a cause may explain little of the whole and
yet all of the error of the motion.  Such a cause is not minor.
"""

from __future__ import annotations

import numpy as np

from twin.estimation.rollout import predict_ahead
from twin.estimation.rollout_periodic import has_phase
from twin.inference.likelihood import Criterion
from twin.inference.theta import Theta
from twin.settings import diagnosis as settings


def error_reduction(criterion: Criterion, before: Theta, after: Theta) -> float:
    """Return the share of the squared error of x 20 ms ahead that `after` removes; 0 without a prediction."""
    if has_phase(before.vector()) or has_phase(after.vector()):
        return 0.0  # the phase was fitted to these very recordings
    first, second = (_square_errors(criterion, theta) for theta in (before, after))
    both = np.isfinite(first) & np.isfinite(second)
    if np.count_nonzero(both) < settings.BENEFIT_PREDICTIONS:
        return 0.0
    # Without the largest hundredth before: single events would decide a mean of squares.
    usual = both & (first <= np.quantile(first[both], settings.BENEFIT_QUANTILE))
    return 1.0 - float(second[usual].mean() / max(first[usual].mean(), 1e-300))


def _square_errors(criterion: Criterion, theta: Theta) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    ahead = max(round(settings.BENEFIT_HORIZON_S / criterion.tick_s), 1)
    criterion.budget.take(criterion.pace.steps_ahead(theta.base(criterion.plant), theta.vector(), ahead))
    samples = criterion.evidence.samples
    x_hat = predict_ahead(theta.system(criterion.plant, criterion.tick_s), samples, ahead)
    return np.asarray((x_hat - samples.x) ** 2)
