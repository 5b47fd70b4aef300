"""Errors grouped by the state in which they occurred, with intervals.

Rule 1: intervals are by block bootstrap over half seconds, because errors of overlapping predictions are correlated.
        The same blocks are drawn for both models, so that their ratio has an interval, too.
Rule 2: a group with too few samples or blocks is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.estimation.family import chance_of_worse
from twin.estimation.record import BoolArray, FloatArray
from twin.settings import diagnosis as settings

Labels = NDArray[np.int64]  # group of each sample, -1: none

DRAWS = 400
MIN_SAMPLES, MIN_BLOCKS = 50, 4
CI = (0.025, 0.975)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A number with its 95 % interval, in the unit of its values."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """A group of samples and the root mean square errors in it, m."""

    label: str
    at: float  # mean of the grouping quantity, SI
    count: int
    baseline: Estimate
    extended: Estimate
    chance: float  # p value of the extended model's error being larger here; NaN without a spread
    worse: bool = False  # whether it is, by `family.holm` over all groups and horizons


@dataclass(frozen=True, slots=True, kw_only=True)
class Regime:
    """Errors by one grouping quantity."""

    name: str
    title: str
    unit: str  # of `at`; empty: the bins have labels only
    bins: tuple[Bin, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """The blocks of the bootstrap, and its draws."""

    of: Labels  # block of each sample, shape (n,)
    drawn: FloatArray  # number of times that each draw takes each block, shape (DRAWS, blocks)

    @property
    def count(self) -> int:
        """Return the number of blocks."""
        return int(self.drawn.shape[1])


def blocks_of(recording: NDArray[np.int32], tick_s: float, seed: int) -> Blocks:
    """Return the blocks of half a second, each within one recording.

    Args:
        recording: index of the recording of each sample, shape (n,).
        tick_s: the sampling interval, s.
        seed: of the random generator.
    """
    n = len(recording)
    # Blocks by H. R. Künsch, The jackknife and the bootstrap for general stationary observations, 1989.  Drawn one by
    # one, errors that overlap would count as independent.
    length = max(round(settings.ERROR_BLOCK_S / tick_s), 1)
    new = np.ones(n, np.bool_)
    new[1:] = recording[1:] != recording[:-1]
    since = np.arange(n) - np.maximum.accumulate(np.where(new, np.arange(n), 0))
    of = np.cumsum(new | (since % length == 0)) - 1
    count = int(of[-1]) + 1 if n else 0
    rng = np.random.default_rng(seed)
    # How often each block is drawn, not which: the means of all groups and draws are then one product of matrices.
    drawn = rng.multinomial(count, np.full(count, 1.0 / count), size=DRAWS) if count else np.zeros((DRAWS, 0))
    return Blocks(of=of, drawn=drawn.astype(np.float64))


def means(
    values: FloatArray, labels: Labels, groups: int, blocks: Blocks
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], NDArray[np.int64]]:
    """Return the means by group and their bootstrap.

    Args:
        values: shape (n,), finite unless the label is -1.
        labels: group of each sample, shape (n,); -1: none.
        groups: number of groups.
        blocks: of the samples.

    Returns:
        (means, shape (groups,); bootstrap means, shape (DRAWS, groups); number of samples and of blocks of each group,
        shape (groups,)).  A mean is NaN if its group is empty.
    """
    use = labels >= 0
    cell = blocks.of[use] * groups + labels[use]
    size = blocks.count * groups
    sums = np.bincount(cell, values[use], size).reshape(blocks.count, groups)
    counts = np.bincount(cell, minlength=size).reshape(blocks.count, groups)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums.sum(axis=0) / counts.sum(axis=0)
        drawn = (blocks.drawn @ sums) / (blocks.drawn @ counts.astype(np.float64))
    return mean, drawn, counts.sum(axis=0), np.count_nonzero(counts, axis=0)


def estimate(value: float, drawn: FloatArray) -> Estimate:
    """A value with its bootstrap interval; NaN of `drawn`, shape (DRAWS,), are draws in which the group was empty."""
    known = drawn[np.isfinite(drawn)]
    low, high = np.quantile(known, CI) if len(known) else (np.nan, np.nan)
    return Estimate(value=float(value), low=float(low), high=float(high))


def solid(samples: NDArray[np.int64], blocks: NDArray[np.int64]) -> BoolArray:
    """Return which groups have enough samples and blocks, shape (groups,)."""
    return np.asarray((samples >= MIN_SAMPLES) & (blocks >= MIN_BLOCKS))


def error_bins(errors_m: FloatArray, labels: Labels, names: Sequence[str], at: FloatArray, blocks: Blocks) -> list[Bin]:
    """Return the root mean square of both models' errors in each group.

    Args:
        errors_m: baseline and extended, shape (2, n).
        labels: group of each sample, shape (n,).
        names: of the groups.
        at: the grouping quantity, shape (n,).
        blocks: of the samples.
    """
    labels = np.where(np.isfinite(errors_m).all(axis=0), labels, -1)
    groups = len(names)
    squares = [means(np.where(labels >= 0, errors**2, 0.0), labels, groups, blocks) for errors in errors_m]
    where, _, samples, pieces = means(np.where(labels >= 0, at, 0.0), labels, groups, blocks)
    good = solid(samples, pieces)
    bins = []
    for group in np.flatnonzero(good).tolist():
        both = [
            estimate(float(np.sqrt(mean[group])), np.sqrt(np.maximum(drawn[:, group], 0.0)))
            for mean, drawn, _, _ in squares
        ]
        drawn = squares[1][1][:, group] / np.maximum(squares[0][1][:, group], 1e-300)
        ratio = float(squares[1][0][group] / max(squares[0][0][group], 1e-300))
        bins.append(
            Bin(
                label=names[group],
                at=float(where[group]),
                count=int(samples[group]),
                baseline=both[0],
                extended=both[1],
                chance=chance_of_worse(ratio, drawn),
            )
        )
    return bins


def bin_labels(values: FloatArray, edges: FloatArray) -> Labels:
    """Group of each value between ascending edges; -1 outside and for NaN."""
    labels = np.searchsorted(edges, values, side="right") - 1
    labels = np.where(values == edges[-1], len(edges) - 2, labels)
    in_range = np.isfinite(values) & (labels >= 0) & (labels < len(edges) - 1)
    return np.where(in_range, labels, -1).astype(np.int64)


def even_edges(values: FloatArray, groups: int) -> FloatArray:
    """Return the edges of groups of equal width between the 0.5 % and 99.5 % quantiles; empty without a spread."""
    known = values[np.isfinite(values)]
    if len(known) < MIN_SAMPLES:
        return np.empty(0)
    # Without the outer half per cent at either end: a single reading far out would stretch all groups.
    low, high = np.quantile(known, (0.005, 0.995))
    return np.linspace(low, high, groups + 1) if high > low else np.empty(0)


def quantile_edges(values: FloatArray, shares: Sequence[float]) -> FloatArray:
    """Return the edges of groups at these quantiles, for quantities mostly near 0; empty with too few samples."""
    known = values[np.isfinite(values)]
    if len(known) < MIN_SAMPLES:
        return np.empty(0)
    # Equal quantiles, as of a quantity that stands still, are one edge.
    edges = np.unique(np.quantile(known, shares))
    return edges if len(edges) > 1 else np.empty(0)
