"""The rivals of a name: curves of unknown origin that would take its place.

A selected cause has been compared with the catalogue alone.  What the catalogue lacks may have taken its name.  So
each name also competes with a curve at each place of the loop, fitted instead of it beside all other causes.

Rule 1: the evidence of a curve is its gain of log-likelihood with its coefficients integrated out by Laplace's method
        (S 12).  Eight numbers have their price, so a curve that merely follows a right name loses by 10 to 35.
Rule 2: a name falls if a curve has more evidence than the name gains.
Rule 3: a curve may be the free form of the name itself: with it nothing could be learnt about the name.  Then the name
        stays if it explains nearly all that the curve does.  It is the right effect by another formula.

The comparison is that of D. J. C. MacKay, Bayesian interpolation, Neural Computation 4(3), 1992.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twin.diagnosis.remainder.curve_fits import (
    CurveScore,
    coefficients,
    fully_fitted,
    roughly_fitted,
    scores,
    visited,
    with_range,
)
from twin.diagnosis.search.score_test import screen
from twin.diagnosis.search.state import Selection, fit_without
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.theta import prior_spread
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Cause
from twin.model.causes.curve import CURVES
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Rival:
    """A curve that explains the recordings better than a name in its place."""

    curve: Cause
    lead: float  # evidence of the curve above the gain of the name, log-likelihood
    fit: Fit  # of the curve beside all other causes
    alone: bool  # whether there are no other causes


def rivals_of(criterion: Criterion, selection: Selection) -> Mapping[str, Rival]:
    """Return the rival of each selected cause that falls.

    Raises:
        Spent: the budget does not pay for it.
    """
    found = {cause: _rival(criterion, selection, cause) for cause in selection.causes}
    return {cause: rival for cause, rival in found.items() if rival is not None}


def _rival(criterion: Criterion, selection: Selection, cause: str) -> Rival | None:
    without = fit_without(criterion, selection, cause)
    gain = selection.fit.loglik - without.loglik
    # A score is the gain of a parabola, which fits exceeded by a factor of up to 2.7.  Far behind is out.
    close = [score for score in scores(criterion, without, CURVES) if settings.RIVAL_SCORE * score.evidence > gain]
    for score in close[: settings.CURVES_FITTED]:
        fit = fully_fitted(criterion, roughly_fitted(criterion, without, score))
        advantage = fit.loglik - without.loglik
        lead = advantage - _price(fit, score) - gain
        free_form = gain >= settings.FREE_FORM_SHARE * advantage and _absorbs(criterion, without, score.curve, cause)
        if lead > 0.0 and not free_form:
            return Rival(curve=score.curve, lead=lead, fit=fit, alone=len(selection.causes) == 1)
    return None


def _price(fit: Fit, score: CurveScore) -> float:
    """Return what the coefficients of a curve cost: half the logarithm of prior over posterior volume."""
    names = coefficients(score.curve)
    index = [fit.free.index(name) for name in names]
    widths = np.array([prior_spread(name) for name in names])
    _, logarithm = np.linalg.slogdet(fit.covariance[np.ix_(index, index)] / np.outer(widths, widths))
    return -0.5 * float(logarithm)


def _absorbs(criterion: Criterion, without: Fit, curve: Cause, cause: str) -> bool:
    """Return whether hardly any information about a cause is left where the curve is free."""
    thinned, candidates = criterion.thinner, [BY_NAME[cause]]
    theta = with_range(
        without.theta, curve, visited(criterion.evidence)[curve.parameters[0].name.removeprefix("from_")]
    )
    before = screen(thinned, without.theta, without.free, candidates)
    after = screen(thinned, theta, (*without.free, *coefficients(curve)), candidates)
    if not before or not after or before[0].visible <= 0.0:
        return False
    return 1.0 - after[0].visible / before[0].visible >= settings.LIKE_SHARE
