"""The gain of the extended model on recordings that were used neither for fitting nor for selection.

Rule 1: the same samples for both models: a prediction counts where both have one.
Rule 2: the noise floor is the error of a right model at that horizon, on the same samples, under sensor noise alone
        (`twin/estimation/prediction_floor.py`).
Rule 3: intervals by block bootstrap: errors 20 ms ahead overlap, blocks of half a second hardly do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from protocol.campaign import Plant
from twin.estimation.pace import pace_of
from twin.estimation.prediction_floor import floor_rmse
from twin.estimation.record import FloatArray
from twin.estimation.rollout import within_reach
from twin.estimation.rollout_periodic import predict
from twin.evidence.gather import Evidence
from twin.identification.horizon import horizons
from twin.inference.budget import Budget, Spent
from twin.inference.noise_floor import Floor
from twin.inference.theta import Theta
from twin.settings import diagnosis as settings

DRAWS = 1000  # of the bootstrap: the standard error of either end is 2 % of the interval


@dataclass(frozen=True, slots=True, kw_only=True)
class Gain:
    """Errors of the position `samples` ahead, before and after."""

    samples: int
    horizon_s: float
    baseline_rmse_m: float
    extended_rmse_m: float
    floor_m: float
    ci95_ratio: tuple[float, float]  # of extended over baseline
    ci95_floor: tuple[float, float]  # of extended over the floor; NaN with too few blocks
    count: int
    # x_hat - x of every sample, baseline and extended, shape (2, n); NaN where one of them predicts nothing
    errors_m: FloatArray = field(default_factory=lambda: np.empty((2, 0)), repr=False, compare=False)

    @property
    def ratio(self) -> float:
        """Return extended over baseline error."""
        return self.extended_rmse_m / max(self.baseline_rmse_m, 1e-300)

    @property
    def tick_s(self) -> float:
        """Return the sampling interval, s."""
        return self.horizon_s / self.samples

    @property
    def removed(self) -> float:
        """Return the removed share of the mean square error above the floor, at most 1; NaN if there was none."""
        return removed_share(self.baseline_rmse_m, self.extended_rmse_m, self.floor_m)


def removed_share(before_m: float, after_m: float, floor_m: float) -> float:
    """Return the removed share of the mean square error above the floor, at most 1; NaN if there was none."""
    excess = before_m**2 - floor_m**2
    return min((before_m**2 - after_m**2) / excess, 1.0) if excess > 0.0 else math.nan


def predictions(evidence: Evidence, theta: Theta, plant: Plant, tick_s: float, samples: int) -> FloatArray:
    """Return x_hat, shape (n,), of every sample `samples` ahead; NaN where there is none."""
    system = theta.system(plant, tick_s)
    x_hat = predict(system, evidence.samples, samples)
    # Without this limit a few predictions near the coil, ten travels off, would make up the whole error.
    return within_reach(x_hat, theta.base(plant), system.c, system.stops)


@dataclass(frozen=True, slots=True, kw_only=True)
class Yardstick:
    """The judge recordings and the data that a prediction needs besides a model."""

    judge: Evidence
    floor: Floor
    plant: Plant
    tick_s: float
    seed: int  # of the bootstrap

    def gain(self, before: Theta, after: Theta, samples: int) -> Gain | None:
        """The gain at one horizon, which is not charged to a budget; None if nothing can be predicted."""
        x, tick_s, plant, seed = self.judge.series.x, self.tick_s, self.plant, self.seed
        errors = [predictions(self.judge, theta, plant, tick_s, samples) - x for theta in (before, after)]
        # The same samples for both: a model that predicts only the easy ones would seem better.
        both = np.isfinite(errors[0]) & np.isfinite(errors[1])
        if both.sum() < 50:
            return None
        first, second = errors[0][both] ** 2, errors[1][both] ** 2
        block = max(round(settings.ERROR_BLOCK_S / tick_s), 1)
        # The floor of the extended model, not of the baseline: it depends on the force gradient, which the two do not
        # share.
        floor_m = floor_rmse(self.floor.quiet(after).system(plant, tick_s), self.judge.samples, samples, both)
        over = (math.nan, math.nan)
        # Of fewer blocks the interval would be too narrow, so there is none.
        if math.isfinite(floor_m) and len(second) >= settings.ERROR_BLOCKS * block:
            over = bootstrap(np.full_like(second, floor_m**2), second, block, seed)
        return Gain(
            samples=samples,
            horizon_s=samples * tick_s,
            baseline_rmse_m=math.sqrt(float(first.mean())),
            extended_rmse_m=math.sqrt(float(second.mean())),
            floor_m=floor_m,
            ci95_ratio=bootstrap(first, second, block, seed),
            ci95_floor=over,
            count=int(both.sum()),
            errors_m=np.where(both, errors, np.nan),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench(Yardstick):
    """A yardstick that is paid from a budget."""

    workers: int
    budget: Budget

    def gains(self, before: Theta, after: Theta) -> list[Gain]:
        """The gains of `after` over `before`, shortest horizon first; empty if nothing can be predicted or paid for."""
        # The longest first, as it takes most time.
        affordable = self._affordable(horizons(self.tick_s)[::-1], (before, after))
        with ThreadPoolExecutor(max_workers=self.workers) as pool:
            gains = pool.map(partial(self.gain, before, after), affordable)
            return [result for result in gains if result is not None][::-1]

    def _affordable(self, lengths: Sequence[int], thetas: Sequence[Theta]) -> list[int]:
        """The horizons within the budget; that of the answer has priority."""
        pace, paid = pace_of(self.judge.series), set()
        for samples in sorted(lengths, key=lambda samples: abs(samples * self.tick_s - settings.BENEFIT_HORIZON_S)):
            with suppress(Spent), self.budget.question(f"the error of x {1e3 * samples * self.tick_s:.0f} ms ahead"):
                self.budget.take(
                    sum(pace.steps_ahead(theta.base(self.plant), theta.vector(), samples) for theta in thetas)
                )
                paid.add(samples)
        return [samples for samples in lengths if samples in paid]


def bootstrap(first: FloatArray, second: FloatArray, block: int, seed: int) -> tuple[float, float]:
    """Return the 95 % interval of the ratio of root mean squares, second over first, by blocks."""
    count = max(len(first) // block, 1)
    # Whole blocks are drawn: errors 20 ms ahead overlap, and single ones would make the interval too narrow.
    edges = np.linspace(0, len(first), count + 1).astype(int)
    sums = np.array([[first[a:b].sum(), second[a:b].sum()] for a, b in pairwise(edges)])
    # Both errors with the same blocks: what makes a stretch hard for either model cancels in the ratio.
    drawn = np.random.default_rng(seed).integers(0, count, size=(DRAWS, count))
    totals = sums[drawn].sum(axis=1)
    ratios = np.sqrt(totals[:, 1] / np.maximum(totals[:, 0], 1e-300))
    # Quantiles of the draws (percentile method; B. Efron, R. Tibshirani, An Introduction to the Bootstrap, 1993).  A
    # normal interval would be symmetric, and a ratio of squares is not.
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(low), float(high)
