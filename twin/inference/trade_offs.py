"""Pairs of parameters that trade off: the recordings determine a combination of both far better than either.

The covariance of the maximum (inverse Fisher information; R. A. Fisher, Philosophical Transactions of the Royal Society
A 222, 1922) gives the ellipse of the two with everything else fitted anew.  A profile likelihood would need a fit for
each of its points; here two runs at the ends of the long axis say how far the log-likelihood is from that parabola.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from protocol.campaign import Plant
from twin.estimation.record import FloatArray
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import Fit, shortened
from twin.inference.theta import PARAMETERS, moved
from twin.settings import diagnosis as settings

# By the quantile of chi-square with two degrees of freedom: both numbers may be off, so the ellipse is larger than
# either interval.
REGION = math.sqrt(-2.0 * math.log(settings.TRADE_OFF_LEVEL))  # standard deviations of two normal variables
END_DROP = 0.5 * settings.TRADE_OFF_END**2  # of log-likelihood there, were it a parabola
_POINTS = 73  # of the contour that is drawn: one for each five degrees


@dataclass(frozen=True, slots=True, kw_only=True)
class TradeOff:
    """Two parameters of which the recordings show a combination."""

    names: tuple[str, str]  # `K_A`, or `cause.parameter`
    values: tuple[float, float]  # at the maximum, in their units
    stds: tuple[float, float]  # standard errors, in their units
    correlation: float
    weights: tuple[float, float] | None  # of relative changes in the combination that is known best; unit length
    contour: FloatArray  # of the 95 % region, in their units, shape (points, 2), finite
    drops: tuple[float, float]  # of log-likelihood at both ends of the long axis; END_DROP for a parabola

    @property
    def narrowing(self) -> float:
        """Return how many times narrower either interval were if the other parameter were known."""
        return 1.0 / math.sqrt(max(1.0 - self.correlation**2, 1e-12))

    @property
    def parabolic(self) -> bool:
        """Return whether the ellipse describes the likelihood within a factor of two."""
        return all(0.5 * END_DROP < drop < 2.0 * END_DROP for drop in self.drops)


def trade_offs(criterion: Criterion, fit: Fit) -> tuple[TradeOff, ...]:
    """Return the pairs of physical parameters whose correlation is at least `MIN_TRADE_OFF`, the strongest first.

    Args:
        criterion: the likelihood; it is evaluated twice for each pair.
        fit: its maximum, with the covariance there.
    """
    return tuple(_trade_off(criterion, fit, pair) for pair in _pairs(fit))


def _pairs(fit: Fit) -> list[tuple[int, int]]:
    """Return the indices of the strongest pairs of physical coordinates."""
    physical = [
        k for k, name in enumerate(fit.free) if ("." in name or name in PARAMETERS) and fit.covariance[k, k] > 0.0
    ]
    pairs = [pair for pair in combinations(physical, 2) if abs(_correlation(fit, pair)) >= settings.MIN_TRADE_OFF]
    return sorted(pairs, key=lambda pair: -abs(_correlation(fit, pair)))[: settings.MAX_TRADE_OFFS]


def _correlation(fit: Fit, pair: tuple[int, int]) -> float:
    i, j = pair
    return float(fit.covariance[i, j] / math.sqrt(fit.covariance[i, i] * fit.covariance[j, j]))


def _trade_off(criterion: Criterion, fit: Fit, pair: tuple[int, int]) -> TradeOff:
    (a, b), plant = (fit.free[k] for k in pair), criterion.plant
    values = fit.theta.value(a), fit.theta.value(b)
    block = fit.covariance[np.ix_(pair, pair)]
    std = np.sqrt(np.diag(block))
    correlation = _correlation(fit, pair)
    # In standard errors the long axis of two normal variables is the diagonal of the sign of their correlation.
    long_axis = std * np.array([1.0, math.copysign(1.0, correlation)]) * math.sqrt(0.5 * (1.0 + abs(correlation)))
    # All other parameters follow by their regression on the two: the ridge of the likelihood, not a cut through it.
    follow = fit.covariance[:, pair] @ np.linalg.pinv(block) @ long_axis
    ends = [shortened(plant, fit.theta, fit.free, sign * settings.TRADE_OFF_END * follow) for sign in (-1.0, 1.0)]
    here, low, high = criterion.values([fit.theta, *ends])
    angle = np.linspace(0.0, 2.0 * math.pi, _POINTS)
    aside = math.sqrt(max(1.0 - correlation**2, 0.0)) * np.sin(angle)
    circle = REGION * std[:, None] * np.vstack([np.cos(angle), correlation * np.cos(angle) + aside])
    contour = np.array(
        [[moved(fit.theta, a, x, plant).value(a), moved(fit.theta, b, y, plant).value(b)] for x, y in circle.T]
    )
    stds = fit.std(a, plant), fit.std(b, plant)
    # A coordinate may fall as its parameter rises: the time of a limit is searched by its inverse.
    correlation *= _sense(fit, a, plant) * _sense(fit, b, plant)
    return TradeOff(
        names=(a, b),
        values=values,
        stds=stds,
        correlation=correlation,
        weights=_best_known(values, stds, correlation),
        # A limit that may be beyond all numbers has a region without end: what can be drawn of it is.
        contour=contour[np.isfinite(contour).all(axis=1)],
        drops=(here - low, here - high),
    )


def _sense(fit: Fit, name: str, plant: Plant) -> float:
    """Return 1 if the parameter rises with its coordinate, else -1."""
    down, up = (moved(fit.theta, name, step, plant).value(name) for step in (-1e-3, 1e-3))
    return 1.0 if up >= down else -1.0


def _best_known(
    values: tuple[float, float], stds: tuple[float, float], correlation: float
) -> tuple[float, float] | None:
    """Return the direction of the least variance of relative changes, of unit length, the first weight positive.

    None where a value is not told from 0: a change relative to it has no meaning.
    """
    if any(abs(value) < settings.TRADE_OFF_END * std for value, std in zip(values, stds, strict=True)):
        return None
    relative = np.array(stds) / np.abs(values)
    covariance = np.outer(relative, relative) * np.array([[1.0, correlation], [correlation, 1.0]])
    first, second = np.linalg.eigh(covariance)[1][:, 0]
    return (abs(float(first)), math.copysign(float(second), first * second))
