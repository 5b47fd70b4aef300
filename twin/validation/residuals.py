"""Residual tests (as `resid` of MATLAB): are the innovations white, of the stated size, and independent of u_c?

Rule 1: e(k) is correlated with u_c(k - lag) for lags of 1 and more only.  In closed loop u_c depends on past
        innovations, so it is correlated with them at other lags under a right model, too.
Rule 2: the bounds in the figure are 99 % bounds of one lag; the verdict is a joint chi-square test over all lags.
Rule 3: each test fails a right model with a probability of LEVEL at most, and ignores negligible differences.  In a
        long campaign even the rounding of the converters is significant, so a size within NOISE_TOLERANCE is right, as
        it is for `diagnose`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from twin.distributions import chi2_above, normal_exceeded
from twin.estimation.innovations import FLIES, FOLLOWS
from twin.estimation.record import FloatArray
from twin.estimation.rollout import SETTLE_S
from twin.estimation.whiteness import LAGS, LEVEL, SMALL
from twin.settings.diagnosis import NOISE_TOLERANCE
from twin.validation.source import Filtered

BOUND_99 = 2.576
BOUND_SIZE = normal_exceeded(0.5 * LEVEL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """Tests of the innovations of one channel."""

    name: str  # i_c | x
    count: int
    chi2: float  # mean square of the whitened innovations: 1 under a right model
    chi2_bound: float  # of |chi2 - 1|
    mean: float  # of the whitened innovations
    autocorrelation: FloatArray  # lags 1 .. LAGS
    cross_correlation: FloatArray  # with u_c, the same lags
    bound: float  # 99 % for one lag
    p_white: float  # of all autocorrelations together
    p_input: float
    white: bool
    independent: bool
    size_right: bool

    @property
    def passed(self) -> bool:
        """Return whether all three tests are passed."""
        return self.white and self.independent and self.size_right


def residuals(runs: Sequence[Filtered]) -> tuple[Channel, ...]:
    """Return the tests of i_c and x over all recordings together; a channel without enough samples is left out."""
    channels = (_channel(runs, column, name) for column, name in ((0, "i_c"), (1, "x")))
    return tuple(channel for channel in channels if channel is not None)


def _channel(runs: Sequence[Filtered], column: int, name: str) -> Channel | None:
    pairs, lag_products, cross, u_products = np.zeros((4, LAGS))
    power, total, count, u_power = 0.0, 0.0, 0, 0.0
    for run in runs:
        e, u, group = _aligned(run, column)
        good = np.isfinite(e)
        if not good.any():
            continue
        e0 = np.where(good, e, 0.0)
        # Without the mean of u_c, which would turn a constant error of e into a correlation with u_c.
        u0 = np.where(good, u - u[good].mean(), 0.0)
        power += float(e0 @ e0)
        total += float(e0.sum())
        count += int(good.sum())
        u_power += float(u0 @ u0)
        for lag in range(1, LAGS + 1):
            same = good[lag:] & good[:-lag] & (group[lag:] == group[:-lag])
            pairs[lag - 1] += float(same.sum())
            lag_products[lag - 1] += float(np.sum(e0[lag:] * e0[:-lag] * same))
            cross[lag - 1] += float(np.sum(e0[lag:] * u0[:-lag] * same))
            u_products[lag - 1] += float(np.sum(u0[lag:] * u0[:-lag] * same))
    # Chi-square is the limit for many pairs: with fewer, the stated chance does not hold.
    if count < 10 * LAGS or pairs.min() < 50 or power == 0.0:
        return None
    # Weighted by the pairs of each lag, because gaps take pairs away (G. E. P. Box, D. A. Pierce, J. of the American
    # Statistical Association 65, 1970).
    rho = lag_products / pairs / (power / count)
    p_white = chi2_above(float(np.sum(pairs * rho**2)), LAGS)
    p_input, r = 1.0, np.zeros(LAGS)
    if u_power > 0.0:
        r = cross / pairs / np.sqrt(power / count * u_power / count)
        # r of different lags is correlated: its covariance is the autocorrelation of u_c over n.
        of_u = np.concatenate(([1.0], u_products[:-1] / pairs[:-1] / (u_power / count)))
        values, vectors = np.linalg.eigh(toeplitz(of_u))
        # Directions in which u_c hardly varies are left out: divided by nearly 0, their noise would decide.
        retained = values > 1e-3 * values.max()
        statistic = float(np.mean(pairs)) * float(np.sum((vectors.T @ r)[retained] ** 2 / values[retained]))
        p_input = chi2_above(statistic, int(retained.sum()))
    size = power / count
    # The stated noise was estimated from a recording of similar length: both estimates have a scatter of sqrt(2 / n).
    bound = max(BOUND_SIZE * np.sqrt(4.0 / count), (1.0 + NOISE_TOLERANCE) ** 2 - 1.0)
    return Channel(
        name=name,
        count=count,
        chi2=size,
        chi2_bound=float(bound),
        mean=total / count,
        autocorrelation=rho,
        cross_correlation=r,
        bound=float(BOUND_99 / np.sqrt(np.mean(pairs))),
        p_white=p_white,
        p_input=p_input,
        white=p_white > LEVEL or float(np.max(np.abs(rho))) < SMALL,
        independent=p_input > LEVEL or float(np.max(np.abs(r))) < SMALL,
        size_right=abs(size - 1.0) < bound,
    )


def _aligned(run: Filtered, column: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (whitened innovations, NaN while the filter settles; u_c; number of the stretch), each of shape (n,)."""
    s = run.series
    broken = (s.flags & FOLLOWS) == 0
    broken |= np.diff((s.flags & FLIES).astype(np.int8), prepend=np.int8(0)) != 0
    group = np.cumsum(broken)
    starts = np.flatnonzero(broken)
    since = np.arange(len(s)) - starts[np.maximum(group - 1, 0)] if len(starts) else np.arange(len(s))
    past_start = since >= round(SETTLE_S / run.source.record.interval_s)
    flies = (s.flags & FLIES) != 0
    e = np.where(past_start & flies, run.white[:, column], np.nan)
    return e, s.u, group.astype(float)
