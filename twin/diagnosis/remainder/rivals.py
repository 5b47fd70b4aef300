"""The rivals of a name: curves of unknown origin that would take its place.

A selected cause has been compared with the catalogue alone.  What the catalogue lacks may have taken its name.  So
each name also competes with a curve at each place of the loop, fitted instead of it beside all other causes.

Rule 1: the likelihood of a fit has the coefficients of a curve integrated out (S 12), as it has the shapes of causes.
        Eight numbers have their price, so a curve that merely follows a right name loses by 10 to 35.
Rule 2: a name falls if a curve in its place is likelier.  Several names may imitate one unknown effect, and then each
        gains a lot beside the others.  So a curve also competes with all of them together.  Each further name costs
        what a name must gain.
Rule 3: a curve may be the free form of a name: both act on the same quantity of the loop, and with the curve nothing
        could be learnt about the name.  The name stays if it alone explains nearly all that this curve does, and no
        curve elsewhere is likelier by more than a class allows.  It is the right effect by another formula.

The comparison is that of D. J. C. MacKay, Bayesian interpolation, Neural Computation 4(3), 1992.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from twin.diagnosis.remainder.curve_fits import coefficients, fully_fitted, roughly_fitted, scores, visited, with_range
from twin.diagnosis.search.score_test import screen
from twin.diagnosis.search.state import Selection, fit_without
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import reinitialised
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Cause
from twin.model.causes.curve import CURVES, FREE_FORM_OF
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Rival:
    """A curve that explains the recordings better than names in their place."""

    curve: Cause
    names: tuple[str, ...]  # that it replaces
    lead: float  # log-likelihood of the model with the curve above that with the names
    fit: Fit  # of the curve beside all other causes
    is_sole: bool  # whether there are no other causes


def rivals_of(criterion: Criterion, selection: Selection) -> Mapping[str, Rival]:
    """Return the rival of each selected cause that falls.

    Raises:
        Spent: the budget does not pay for it.
    """
    rivals: dict[str, Rival] = {}
    # All names first: where they fall together, the single ones need no fits.  Pairs beside a right name are not tried,
    # as three names would then cost seven times two fits.
    for names in dict.fromkeys((selection.causes, *((cause,) for cause in selection.causes))):
        if set(names) <= set(rivals):
            continue
        rival = _rival(criterion, selection, names)
        if rival is not None:
            rivals |= dict.fromkeys(rival.names, rival)
    return rivals


def best_curve(criterion: Criterion, base: Fit) -> Fit | None:
    """Return the likeliest fit of the paper's model with one curve; None where no curve's quantity moves."""
    leading = scores(criterion, base, CURVES)[: settings.RIVALS_FITTED]
    fits = [fully_fitted(criterion, roughly_fitted(criterion, base, score)) for score in leading]
    return max(fits, key=lambda fit: fit.loglik, default=None)


def _rival(criterion: Criterion, selection: Selection, names: tuple[str, ...]) -> Rival | None:
    without = _fit_without(criterion, selection, names)
    gain = selection.fit.loglik - without.loglik
    # A score is the gain of a parabola, which fits exceeded by a factor of up to 6.  Far behind is out.
    close = [score for score in scores(criterion, without, CURVES) if settings.RIVAL_SCORE * score.evidence > gain]
    rivals: list[Rival] = []
    for score in close[: settings.RIVALS_FITTED]:
        # Of those fits none was more than a tenth short of its maximum.
        goal = without.loglik + settings.FREE_FORM_SHARE * gain
        fit = roughly_fitted(criterion, without, score, goal=goal)
        if fit.loglik < goal:
            continue
        fit = fully_fitted(criterion, fit)
        lead = fit.loglik - selection.fit.loglik + (len(names) - 1) * settings.MIN_GAIN
        if lead > 0.0:
            is_sole = len(names) == len(selection.causes)
            rivals.append(Rival(curve=score.curve, names=names, lead=lead, fit=fit, is_sole=is_sole))
    if not rivals:
        return None
    best = max(rivals, key=lambda rival: rival.lead)
    # Several names fall together or not at all: if one is right by another formula, the others are compared alone.
    equal = [rival for rival in rivals if best.lead - rival.lead <= settings.EQUIVALENT_GAIN]
    is_free_form = any(_is_free_form(criterion, selection, name, rival) for rival in equal for name in names)
    return None if is_free_form else best


def _fit_without(criterion: Criterion, selection: Selection, names: tuple[str, ...]) -> Fit:
    """Return the fit without these causes."""
    if len(names) == len(selection.causes):
        return selection.base
    if len(names) == 1:
        return fit_without(criterion, selection, names[0])
    free = tuple(name for name in selection.fit.free if name.partition(".")[0] not in names)
    theta = selection.fit.theta
    for name in names:
        theta = theta.without(name, criterion.plant)
    return selection.recall(free) or climb(criterion, reinitialised(theta), free)


def _is_free_form(criterion: Criterion, selection: Selection, name: str, rival: Rival) -> bool:
    """Return whether a curve in the place of names is only the free form of one of them."""
    if not _is_at(rival.curve, name):
        return False
    without = _fit_without(criterion, selection, rival.names)
    removed = tuple(cause for cause in rival.names if cause != name)
    with_name = _fit_without(criterion, selection, removed) if removed else selection.fit
    share = (with_name.loglik - without.loglik) / (rival.fit.loglik - without.loglik)
    return share >= settings.FREE_FORM_SHARE and _absorbs(criterion, without, rival.curve, name)


def _is_at(curve: Cause, name: str) -> bool:
    """Return whether a curve acts on the same quantity of the loop as this cause."""
    return BY_NAME[name].acts_on in FREE_FORM_OF[curve.name]


def _absorbs(criterion: Criterion, without: Fit, curve: Cause, cause: str) -> bool:
    """Return whether hardly any information about a cause is left where the curve is free."""
    thinned, candidates = criterion.thinner, [BY_NAME[cause]]
    theta = with_range(without.theta, curve, visited(criterion.evidence))
    before = screen(thinned, without.theta, without.free, candidates)
    after = screen(thinned, theta, (*without.free, *coefficients(curve)), candidates)
    if not before or not after or before[0].visible <= 0.0:
        return False
    return 1.0 - after[0].visible / before[0].visible >= settings.LIKE_SHARE
