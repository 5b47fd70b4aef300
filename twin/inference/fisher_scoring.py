"""The maximum of the likelihood of the extended model, by `optimiser.py`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from protocol.campaign import Plant
from twin.estimation.record import FloatArray
from twin.estimation.structures import Results
from twin.inference import optimiser
from twin.inference.likelihood import Criterion, mean_square
from twin.inference.optimiser import CLOSE, SLOW_TOLERANCE, Slopes, active_of, covariance_of
from twin.inference.optimiser import Fit as Fit
from twin.inference.theta import Theta, parameter_of, prior_spread
from twin.model.causes.catalogue import with_trait
from twin.settings import diagnosis as settings

TOLERANCE = 0.02  # of a standard error: 2e-4 of log-likelihood is left


def with_covariance(criterion: Criterion, fit: Fit, slopes: tuple[FloatArray, FloatArray] | None = None) -> Fit:
    """Return the fit with the covariance of its free coordinates at the maximum itself.

    It comes from `slopes`, (score, Fisher information) in the free coordinates, or from new derivatives.
    """
    score, fisher = slopes or criterion.gradient(fit.theta, fit.free)[1:]
    active = active_of(criterion.plant, fit.theta, fit.free, score)
    return replace(fit, covariance=covariance_of(fisher, active))


def spreads(fit: Fit, plant: Plant) -> dict[str, float]:
    """Return the standard errors of all free parameters in their own units."""
    return {name: fit.std(name, plant) for name in fit.free}


def climb(
    criterion: Criterion,
    start: Theta,
    free: Sequence[str],
    *,
    passes: int = settings.PASSES,
    tolerance: float = TOLERANCE,
    approximate: bool = False,
    goal: float = -math.inf,
) -> Fit:
    """Climb to the maximum from `start`; coordinates not in `free` stay.

    With `approximate`, cheaper slopes lead near the maximum, and the fit counts as not converged.  The climb ends early
    where it will not come near the log-likelihood `goal`.

    What varies from tick to tick is free only at the maximum of the rest: far from it, it would take up all errors.
    """
    spreads = [name for name in free if _varies(name) and start.value(name) == parameter_of(name).neutral]
    if spreads:
        rest = [name for name in free if name not in spreads]
        fit = climb(criterion, start, rest, passes=passes, tolerance=tolerance, approximate=approximate, goal=goal)
        start = fit.theta.all_of((name, settings.START_SPREAD * parameter_of(name).probes[0]) for name in spreads)
        if fit.converged and criterion.value(start) > fit.loglik - narrowing(rest, fit.covariance):
            varying = climb(criterion, start, free, passes=passes, tolerance=tolerance)
            # A spread also leads across the kinks at which a fixed delay stops.
            steady = varying.theta.all_of((name, parameter_of(name).neutral) for name in spreads)
            fit = max(
                fit, climb(criterion, steady, rest, passes=passes, tolerance=tolerance), key=lambda fit: fit.loglik
            )
            if varying.loglik > fit.loglik:
                return varying
        return _with_neutral(fit, free)
    # An approximate fit stops at the looser tolerance: its slopes are not worth more.
    surface = _Surface(criterion, approximate=approximate)
    top = optimiser.climb(
        surface,
        start,
        free,
        passes=passes,
        tolerance=SLOW_TOLERANCE if approximate else tolerance,
        patience=2,
        goal=goal,
    )
    return replace(
        top,
        loglik=top.loglik + narrowing(free, top.covariance),
        # Never converged by rough slopes: they give the direction of a step, but not the maximum.
        converged=top.converged and not approximate,
        ahead=max(top.ahead, settings.ROUGH_LEFT) if approximate else top.ahead,
    )


def _varies(name: str) -> bool:
    return "." in name and parameter_of(name).random and not parameter_of(name).walks


def _with_neutral(fit: Fit, free: Sequence[str]) -> Fit:
    """Return the fit as one in `free`, of which those that it did not have stay where they are."""
    covariance = np.zeros((len(free), len(free)))
    indices = [free.index(name) for name in fit.free]
    covariance[np.ix_(indices, indices)] = fit.covariance
    return replace(fit, free=tuple(free), covariance=covariance)


def approach(criterion: Criterion, start: Theta, free: Sequence[str]) -> Fit:
    """Climb from `start` to near the maximum, most of the way over part of the samples.

    Its likelihood is that of all samples.  `ahead` is the gain that the part leaves.  The slope at its
    end promises some of it.  The scatter of the maxima of parts adds half a unit for each coordinate and further part.
    """
    part = criterion.thinner
    if part is not criterion:
        fast = [name for name in free if not _is_slow(name)]
        fit = _with_neutral(climb(part, start, fast, passes=settings.PASSES_APPROACH, approximate=True), free)
        before, after = criterion.values([start, fit.theta])
    # Going astray is judged by all samples, which cost two runs; the part's own likelihood would not show it.
    if part is criterion or after < before:  # the part does not show an effect, and the fit went astray
        return climb(criterion, start, free, passes=settings.PASSES_FIRST, approximate=True)
    # Information grows with the number of samples, so the covariance of the part shrinks by its share.
    covariance = part.share * fit.covariance
    return replace(
        fit,
        loglik=after + narrowing(free, covariance),
        covariance=covariance,
        ahead=fit.ahead / part.share + 0.5 * len(free) * (1.0 / part.share - 1.0),
    )


def _is_slow(name: str) -> bool:
    """Tell whether a coordinate is the time of a slow effect, which would run to its limit over a part of the samples.

    The blocks of a part are short, and each begins anew.
    """
    return name.partition(".")[0] in with_trait("warms") and parameter_of(name).unit == "s"


def narrowing(free: Sequence[str], covariance: FloatArray) -> float:
    """Return the logarithm of how much narrower the shapes are than their priors, not positive.

    Added to the maximum it gives the likelihood with the shapes integrated out, by Laplace's method (R. E. Kass,
    A. E. Raftery, Journal of the American Statistical Association 90, 1995): a cause of many forms is not preferred
    because one of them happens to fit.  A shape at its bound counts as it is.

    Args:
        free: the coordinates.
        covariance: of the coordinates, shape (count, count).
    """
    spreads = {name: prior_spread(name) for name in free}
    # Only shapes count, as only they have a prior.  An Occam factor for strengths would need a prior for each rig.
    priors = [k for k, name in enumerate(free) if math.isfinite(spreads[name]) and covariance[k, k] > 0.0]
    if not priors or not np.isfinite(covariance).all():
        return 0.0
    prior = np.array([spreads[free[k]] for k in priors])
    _, logarithm = np.linalg.slogdet(covariance[np.ix_(priors, priors)] / np.outer(prior, prior))
    return min(0.5 * float(logarithm), 0.0)


class _Surface:
    """The criterion as an optimiser's surface; far from the maximum it uses slopes that cost less.

    Args:
        criterion: the likelihood.
        approximate: whether a point near the maximum suffices.
    """

    def __init__(self, criterion: Criterion, *, approximate: bool = False) -> None:
        self.plant, self._criterion, self._approximate = criterion.plant, criterion, approximate

    def visit(self, point: Theta) -> tuple[float, Results]:
        run = self._criterion.run(point)
        return self._criterion.loglik(point, run.innovations), run

    def slopes(
        self, point: Theta, results: Results, free: Sequence[str], before: Slopes | None, decrement: float
    ) -> Slopes:
        if before is not None and decrement <= CLOSE:
            # The derivatives are as good as those of this point.
            return self._of(point, results, free, before.retained, exact=before.exact, fresh=False)
        # The mean square of the whitened innovations shows how wrong the model still is.  Rough slopes of a very wrong
        # model may point the wrong way, and cheap slopes do not pay for steps that are rejected.
        rough = mean_square(results.innovations) < settings.EXACT_SLOPES_SQUARE
        _, change = self._criterion.derivatives(point, free, results, rough=rough)
        return self._of(point, results, free, change, exact=self._approximate or not rough)

    def exact(self, point: Theta, results: Results, free: Sequence[str]) -> Slopes:
        _, change = self._criterion.derivatives(point, free, results)
        return self._of(point, results, free, change)

    def _of(
        self,
        point: Theta,
        run: Results,
        free: Sequence[str],
        change: FloatArray,
        *,
        exact: bool = True,
        fresh: bool = True,
    ) -> Slopes:
        _, score, fisher = self._criterion.slopes(point, free, run.innovations, change)
        return Slopes(score=score, fisher=fisher, exact=exact, fresh=fresh, retained=change)
