"""Prediction errors of x in blocks of time, and the ratio of two of them with its interval.

Errors of overlapping predictions are correlated, so the unit of the statistics is a block, longer than any horizon.

Rule 1: two models are compared on the samples that both predict, block by block: a hard block is hard for both.
Rule 2: two flights share no samples, so their blocks are independent.
Rule 3: an error that changes more slowly than a block, such as warming up, makes the intervals too narrow.

Sources: W. G. Cochran, Sampling Techniques, 3rd ed. (1977), section 6.4, the variance of a ratio of totals;
F. X. Diebold and R. S. Mariano, Comparing Predictive Accuracy, J. Business & Economic Statistics 13 (1995), the loss
differential of paired predictions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.distributions import student_above, student_quantile
from twin.estimation.record import FloatArray, Record
from twin.identification.horizon import horizons
from twin.model.parameters import Model
from twin.prediction import Prediction, predict
from twin.settings.diagnosis import ERROR_BLOCK_S

MIN_BLOCKS = 6  # fewer: the spread of the blocks is not known
WHOLE = "whole travel"
REGIONS = ("lower third", "middle third", "upper third")  # of the travel, by the measured x


@dataclass(frozen=True, slots=True, kw_only=True)
class Totals:
    """Totals of the squared errors of one side, by block."""

    squares: FloatArray  # m^2, shape (blocks,)
    counts: FloatArray  # of predictions, shape (blocks,)

    @property
    def rmse_m(self) -> float:
        """Return the root mean square error, m; NaN without predictions."""
        count = float(self.counts.sum())
        return math.sqrt(float(self.squares.sum()) / count) if count else math.nan

    def relative_spread(self, other: Totals | None = None) -> float:
        """Return the standard error of the logarithm of the mean square (Cochran, 1977, eq. 6.13).

        Args:
            other: that of the other side on the same samples, for the logarithm of the ratio; None: of this side alone.
        """
        reference = self.counts if other is None else other.squares
        blocks = len(self.squares)
        if blocks < 2 or not reference.sum() or not self.squares.sum():
            return math.nan
        ratio = self.squares.sum() / reference.sum()
        left = self.squares - ratio * reference
        return float(math.sqrt(blocks / (blocks - 1) * float(left @ left)) / self.squares.sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """The error of the second side over that of the first, at one horizon in one region."""

    horizon_s: float
    region: str  # "whole travel", or one of REGIONS
    first_m: float  # root mean square errors, m
    second_m: float
    ratio: float
    ci95: tuple[float, float]  # of the ratio
    chance: float  # two-sided p value of a ratio of 1
    count: int  # predictions of both sides
    blocks: int
    significant: bool = False  # by Holm's method over all changes of the comparison


def predictions(model: Model, record: Record) -> list[Prediction]:
    """Predict a flight at all horizons.  Raises DataError."""
    return [predict(model, record, ahead) for ahead in horizons(record.interval_s)]


def paired(first: Sequence[Prediction], second: Sequence[Prediction], travel_m: float) -> list[Change]:
    """Compare two models at one horizon on the samples that both predict; one pair of predictions for each flight."""
    rows = []
    for a, b in zip(first, second, strict=True):
        # Common samples only: a model that predicts the easy ones alone would look better.
        _, in_first, in_second = np.intersect1d(a.t, b.t, assume_unique=True, return_indices=True)
        errors = np.array([(a.x_hat - a.x)[in_first], (b.x_hat - b.x)[in_second]])
        rows.append((a.t[in_first], a.x[in_first], errors))
    changes = []
    for region in (WHOLE, *REGIONS):
        totals = [_totals([(t, x, e[side]) for t, x, e in rows], region, travel_m) for side in (0, 1)]
        spread = totals[1].relative_spread(totals[0])
        changes.append(_change(first[0], region, totals, spread, len(totals[0].counts) - 1))
    return _informative(changes)


def unpaired(first: Prediction, second: Prediction, travel_m: float) -> list[Change]:
    """Compare two flights under one model at one horizon; degrees of freedom by B. L. Welch, Biometrika 34 (1947)."""
    changes = []
    for region in (WHOLE, *REGIONS):
        totals = [
            _totals([(change.t, change.x, change.x_hat - change.x)], region, travel_m) for change in (first, second)
        ]
        spreads = [side.relative_spread() for side in totals]
        freedom = [len(side.counts) - 1 for side in totals]
        variance = sum(spread**2 for spread in spreads)
        divisor = sum(spread**4 / max(f, 1) for spread, f in zip(spreads, freedom, strict=True))
        # Not the pooled degrees of freedom: flights of different length and noise have different spreads.
        welch = variance**2 / divisor if divisor > 0.0 else math.nan
        changes.append(_change(first, region, totals, math.sqrt(variance), welch if min(freedom) > 0 else 0.0))
    return _informative(changes)


def _informative(changes: list[Change]) -> list[Change]:
    """The whole travel, and the regions if the flights visit more than one."""
    whole, *regions = changes
    visited = [change for change in regions if change.count]
    return [whole, *visited] if len(visited) > 1 else [whole]


def _totals(flights: Sequence[tuple[FloatArray, FloatArray, FloatArray]], region: str, travel_m: float) -> Totals:
    """The totals of (t in s, x in m, error in m) of all flights, in this region."""
    squares, counts = [], []
    for t, x, error in flights:
        if region != WHOLE:
            # By the measured x: by the prediction a sample could be in two regions.
            third = np.clip(np.floor(3.0 * x / travel_m), 0, 2)
            t, error = (values[third == REGIONS.index(region)] for values in (t, error))
        if len(t):
            # By time, not by number: behind a gap a block would hold errors that are far apart.
            block = np.floor((t - t[0]) / ERROR_BLOCK_S).astype(np.int64)
            squares.append(np.bincount(block, error**2))
            counts.append(np.bincount(block).astype(float))
    total, count = (np.concatenate(parts) if parts else np.zeros(0) for parts in (squares, counts))
    return Totals(squares=total[count > 0], counts=count[count > 0])


def _change(at: Prediction, region: str, totals: Sequence[Totals], spread: float, freedom: float) -> Change:
    """The change with Student's t for the logarithm of the ratio of mean squares."""
    blocks, ratio = min(len(side.counts) for side in totals), totals[1].rmse_m / (totals[0].rmse_m or math.nan)
    enough = blocks >= MIN_BLOCKS and math.isfinite(ratio) and spread > 0.0 and freedom > 0.0
    # In logarithms: half and twice the error are equally far from 1, and the interval stays positive.
    width = student_quantile(0.975, freedom) * spread / 2.0 if enough else math.nan  # of log rms: half the log square
    return Change(
        horizon_s=at.ahead * at.interval_s,
        region=region,
        first_m=totals[0].rmse_m,
        second_m=totals[1].rmse_m,
        ratio=ratio,
        ci95=(ratio * math.exp(-width), ratio * math.exp(width)),
        chance=2.0 * student_above(abs(2.0 * math.log(ratio)) / spread, freedom) if enough else math.nan,
        count=int(min(side.counts.sum() for side in totals)),
        blocks=blocks,
    )
