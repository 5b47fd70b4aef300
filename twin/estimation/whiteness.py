"""Whiteness test: whether the innovations are white and as large as the filter predicts.

Source: Ljung and Box, Biometrika 65(2), 1978.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.distributions import chi2_above
from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.estimation.record import FloatArray

LAGS = 25
SMALL = 0.015  # autocorrelation below which residuals are white, however significant
LEVEL = 1e-3  # p-value of the Ljung-Box test below which residuals are coloured


@dataclass(frozen=True, slots=True, kw_only=True)
class Whiteness:
    """Whiteness of the innovations of both channels."""

    chi2_i: float  # mean square of i_c, 1 under a right model
    chi2_x: float
    p_i: float  # Ljung-Box over 25 lags; NaN without data
    p_x: float
    worst: float  # largest autocorrelation of the two
    white: bool


def whiteness(series: Series, white: FloatArray) -> Whiteness:
    """Test both channels over all chains (Ljung and Box, 1978); pairs of samples count within a chain or flight.

    Args:
        series: the samples.
        white: whitened innovations, shape (n, 2).
    """
    broken = (series.flags & FOLLOWS) == 0
    turned = np.diff((series.flags & FLIES).astype(np.int8), prepend=np.int8(0)) != 0
    results = []
    for column, edges in ((0, broken), (1, broken | turned)):
        groups = np.cumsum(edges, dtype=np.int32)
        values = white[:, column]
        good = np.isfinite(values)
        n = int(good.sum())
        if n < 10 * LAGS:
            results.append((float(np.nanmean(values**2)) if n else float("nan"), float("nan"), 0.0))
            continue
        filled = np.where(good, values, 0.0)
        power = float(filled @ filled)
        if power == 0.0:  # simulated without noise, by this very model
            results.append((0.0, float("nan"), 0.0))
            continue
        statistic, worst = 0.0, 0.0
        for lag in range(1, LAGS + 1):
            same = good[lag:] & good[:-lag] & (groups[lag:] == groups[:-lag])
            pairs = int(same.sum())
            if pairs < 50:
                continue
            rho = float(np.sum(filled[lag:] * filled[:-lag] * same)) / power * n / pairs
            # With the pairs of each lag in place of n (n + 2) / (n - k): many chains have fewer pairs at long lags.
            statistic += pairs * rho * rho
            worst = max(worst, abs(rho))
        results.append((power / n, chi2_above(statistic, LAGS), worst))
    (chi2_i, p_i, worst_i), (chi2_x, p_x, worst_x) = results
    known = [p for p in (p_i, p_x) if np.isfinite(p)]
    return Whiteness(
        chi2_i=chi2_i,
        chi2_x=chi2_x,
        p_i=p_i,
        p_x=p_x,
        worst=max(worst_i, worst_x),
        # Significance alone would not do: in a long campaign even the effect of rounding is significant.
        white=min(known, default=1.0) > LEVEL or max(worst_i, worst_x) < SMALL,
    )
