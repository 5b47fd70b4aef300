"""Maximum likelihood of the paper's model over a campaign: four parameters of (1), (6) and four noise levels.

The likelihood is that of `twin/inference/likelihood.py`, without causes, stops and points of rest.

Rule 1: a long recording is treated in blocks, and only the derivatives of one block are in memory.  Those of an hour at
        500 Hz would need two gigabytes.
Rule 2: each pass has exact derivatives, because standard errors and intervals come from them.
Rule 3: numerical problems do not raise: an impossible step is rejected, and `converged` reports convergence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.estimation.innovations import FOLLOWS, Series, information
from twin.estimation.prepare import BLOCK_SAMPLES
from twin.estimation.record import FloatArray
from twin.evidence.gather import Evidence
from twin.evidence.starting.regression import newey_west
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import Fit, Slopes, climb, inverse
from twin.inference.theta import Theta
from twin.settings import identification as settings

TOLERANCE = 0.01  # Newton decrement of convergence, standard errors
PASSES = 40


class Blocks:
    """The likelihood of a series as the sum over its blocks: a surface for `twin/inference/optimiser.py`.

    `whole` is the likelihood of a `bare` series; its owner closes it.
    """

    def __init__(self, whole: Criterion) -> None:
        self.whole, self.plant, evidence = whole, whole.plant, whole.evidence
        self._parts = [
            whole.over(replace(evidence, series=evidence.series.part(block), t=evidence.t[block]))
            for block in _blocks(evidence.series)
        ]

    @property
    def series(self) -> Series:
        """The samples."""
        return self.whole.evidence.series

    def white(self, theta: Theta) -> FloatArray:
        """Return the whitened innovations, shape (n, 2), NaN where unused."""
        return np.concatenate([np.empty((0, 2)), *(part.white(theta)[1] for part in self._parts)])

    def visit(self, point: Theta) -> tuple[float, None]:
        """Return (log-likelihood, None): nothing is stored for the derivatives, to save memory."""
        return sum(part.value(point) for part in self._parts), None

    def slopes(
        self, point: Theta, outputs: None, free: Sequence[str], before: Slopes | None, decrement: float
    ) -> Slopes:
        """Return the exact derivatives; see `exact`."""
        return self.exact(point, outputs, free)

    def exact(self, point: Theta, outputs: None, free: Sequence[str]) -> Slopes:
        """Return the score and Fisher information at this point."""
        score, fisher, _ = self._sums(point, free)
        return Slopes(score=score, fisher=fisher)

    def sandwich(self, fitted: Fit) -> Fit:
        """The fit with the sandwich covariance, which holds for coloured residuals: F^-1 (sum of scores) F^-1.

        The sum is taken within blocks.
        """
        lags = max(round(settings.RESIDUAL_MEMORY_S / self.whole.tick_s), 1)
        _, fisher, middle = self._sums(fitted.theta, fitted.free, lags)
        active = np.diag(fitted.covariance) > 0.0
        inner = inverse(fisher[np.ix_(active, active)])
        robust = np.zeros_like(fitted.covariance)
        # H. White, Econometrica 50(1), 1982; the middle by W. K. Newey, K. D. West, Econometrica 55(3), 1987.  A model
        # of the residuals would have to be right itself.
        robust[np.ix_(active, active)] = inner @ middle[np.ix_(active, active)] @ inner
        return replace(fitted, covariance=robust)

    def _sums(self, theta: Theta, free: Sequence[str], lags: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return score, Fisher information and Newey-West sum of scores; `lags`: of that sum, 0 for none."""
        count = len(free)
        score, fisher, middle = np.zeros(count), np.zeros((count, count)), np.zeros((count, count))
        for part in self._parts:
            # Not `Criterion.slopes`: there is no evidence outside the series, and each sample's score is needed here.
            base, change = part.derivatives(theta, free, part.run(theta))
            scores = np.empty((len(base), count))
            information(base, change, scores, fisher)
            score += scores.sum(axis=0)
            if lags:
                middle += newey_west(scores, lags)
        return score, fisher, middle


def bare(series: Series) -> Evidence:
    """A series alone as evidence."""
    return Evidence(series=series, t=series.samples.t)


def fit(likelihood: Blocks, start: Theta, free: Sequence[str], *, passes: int = PASSES) -> Fit:
    """Maximise the likelihood from `start` over the coordinates `free`, with at most `passes` passes."""
    return climb(likelihood, start, free, passes=passes, tolerance=TOLERANCE, patience=3)


def _blocks(series: Series) -> list[slice]:
    edges = [0]
    for start in np.flatnonzero(series.flags & FOLLOWS == 0):
        # Only at the start of a chain: a cut elsewhere would make the filter forget its state.
        if start - edges[-1] >= BLOCK_SAMPLES:
            edges.append(int(start))
    return [slice(a, b) for a, b in zip(edges, [*edges[1:], len(series)], strict=True) if b > a]
