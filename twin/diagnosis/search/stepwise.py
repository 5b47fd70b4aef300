"""Stepwise selection: which causes the model needs, by the likelihood of all recordings for fitting.

    forward: add the best candidate if it meets rule 1; else a pair that explains nearly all (pairs.py)
    -> backward: remove causes that are no longer needed; repeat both
    -> find the causes that explain the data as well as each selected one (equivalence.py)

Rule 1: a cause is selected if it raises the log-likelihood by more than MIN_GAIN and its strength is within its
        physical range.  While more than noise is unexplained, it must also explain a fair share of that.  A
        significant but minor effect next to a large unexplained rest is typical of a false name.
Rule 2: the judge recordings are not used here.
Rule 3: a step that exceeds the budget makes no new selection, and the search ends with the one before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

from twin.diagnosis.search import periodic
from twin.diagnosis.search.equivalence import find_classes
from twin.diagnosis.search.forward_step import forward
from twin.diagnosis.search.pairs import join
from twin.diagnosis.search.state import Selection, fit_without, material, superfluous
from twin.diagnosis.search.task import Search
from twin.inference.budget import Spent
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import reinitialised
from twin.settings import diagnosis as settings


def select(search: Search, base: Fit, *, classes: bool = True) -> Selection:
    """Select causes: forward steps, backward steps, equivalence classes.

    Args:
        search: the data and the candidates.
        base: the model without causes, at its best.
        classes: whether to find the equivalence classes; otherwise `find_classes` can do so later.
    """
    selection = Selection(base=base, fit=base)
    # The steps are yielded one by one.  A function that returned the end alone would lose every step before `Spent`.
    unanswered = search.criterion.budget.unanswered
    try:
        for step_result in _steps(search, selection, classes):
            selection = step_result
    except Spent:
        rest = [cause for cause in selection.causes if cause not in selection.classes]
        if classes and rest and _confounder_question(rest) not in unanswered:
            unanswered.append(_confounder_question(rest))
    return selection


def _confounder_question(causes: Sequence[str]) -> str:
    return f"whether other causes explain as much as {' or '.join(causes)}"


def _steps(search: Search, selection: Selection, classes: bool) -> Iterator[Selection]:
    """Yield the selection after each step."""
    # A lower required share asks for more causes, so the catalogue alone then limits their number.
    max_causes = settings.MAX_CAUSES if search.min_share >= settings.MIN_SHARE else len(search.candidates)
    # Forward and backward steps alone are greedy: a false first name stays if the later ones lean on it.  The class
    # search may replace it, and then the forward steps are worth another try.  The number of round trips is limited,
    # as two causes of one class could replace each other for ever.
    outdone = False
    for _ in range(settings.ROUND_TRIPS if search.thorough and classes else 1):
        while len(selection.causes) < max_causes:
            for step_result in _add(search, selection):
                yield (selection := step_result)
            if outdone := _outdone(search, selection):
                break
            # A pair only after a refusal: it costs a fit for each of many candidates, and a single cause is the simpler
            # answer.
            if selection.rounds[-1].selected:
                continue
            if len(selection.causes) + 2 <= max_causes:
                yield (selection := _add_pair(search, selection))
            if not selection.rounds[-1].selected:
                break
        if not classes:
            break
        before = set(selection.causes)
        # Before the classes and after them: a lag beside phases of another model explains too little, and a new cause
        # has other phases.
        yield (selection := _refine_phases(search, selection))
        with search.criterion.budget.question(_confounder_question(selection.causes)):
            # The names fall as rivals of the curve, so their classes are worth little effort.
            selection = find_classes(replace(search, quick=True) if outdone else search, selection)
        yield selection
        yield (selection := _refine_phases(search, selection))
        # A cause that was refused next to a false name may be needed next to the right one.
        if outdone or set(selection.causes) == before or not material(search, selection.fit):
            break
    if classes and len(selection.causes) > 1 and selection.overlaps:
        yield _sole(search, selection)


def _outdone(search: Search, selection: Selection) -> bool:
    """Tell whether one curve leaves only noise, and is likelier than several names by the price of each.

    The names then fall as its rivals (`remainder/rivals.py`), unless one of them alone is its effect.
    """
    if len(selection.causes) < 2:
        return False
    fit, price = selection.fit, len(selection.causes) * settings.MIN_GAIN
    if search.floor.under(search.criterion, fit.theta).excess(fit.loglik) < price:
        return False
    curve = search.curve()
    if curve is None or curve.loglik < fit.loglik + price or material(search, curve):
        return False
    search.report("a curve of unknown origin explains more than the names: no further one is looked for")
    return True


def _sole(search: Search, selection: Selection) -> Selection:
    """Return the selection with the one cause that alone explains nearly all that is missing, if there is one.

    Others beside it only correct its form, and hide what is lost without it.
    """
    criterion, base = search.criterion, selection.base

    def fit_single(cause: str) -> Fit:
        free = (*base.free, *(name for name in selection.fit.free if name.startswith(cause + ".")))
        theta = selection.fit.theta
        for dropped in set(selection.causes) - {cause}:
            theta = theta.without(dropped, criterion.plant)
        return selection.recall(free) or climb(criterion, reinitialised(theta), free)

    question = "whether one of several similar causes explains nearly all alone"
    with criterion.budget.question(question):
        fits = dict(zip(selection.causes, criterion.each(fit_single, selection.causes), strict=True))
        cause = max(fits, key=lambda name: fits[name].loglik)
        gain = fits[cause].loglik - base.loglik
        left = search.floor.under(criterion, selection.fit.theta).excess(selection.fit.loglik)
        if gain < settings.FREE_FORM_SHARE * (selection.fit.loglik - base.loglik + max(left, 0.0)):
            return selection
        search.report(f"{cause} alone explains nearly all: the others only correct its form")
        return find_classes(search, replace(selection, causes=(cause,), fit=fits[cause], gains={cause: gain}))


def _refine_phases(search: Search, selection: Selection) -> Selection:
    """Fit the phases of a periodic force together with all other causes."""
    if not search.thorough or periodic.CAUSE.name not in selection.causes:
        return selection
    with search.criterion.budget.question("which phases the periodic force has together with the other causes"):
        return replace(selection, fit=periodic.refine_phases(search.criterion, selection.fit, settings.PASSES))


def _add_pair(search: Search, selection: Selection) -> Selection:
    """Add two causes that explain enough only together, then remove causes that are no longer needed."""
    with search.criterion.budget.question("whether two causes explain together what neither explains alone"):
        joined = join(search, selection)
        return backward(search, joined) if joined is not selection else selection


def _add(search: Search, selection: Selection) -> Iterator[Selection]:
    """Make a forward step, then remove causes that are no longer needed; yields the selection after each part."""
    step = forward(search, selection.base, selection.fit)
    criterion = search.criterion
    selection = replace(selection, rounds=(*selection.rounds, step))
    if not step.selected:
        refused = f": {step.best.cause}, +{step.best.gain:.1f}, {step.refusal}" if step.best else ""
        search.report(f"none selected{refused}")
        yield selection
        return
    first = step.trials[0]
    # The gain of the trial, until `backward` measures what is lost without the cause beside the later ones.
    gains = {**selection.gains, step.selected: first.gain}
    fit = _revived(criterion, first.fit)
    yield (selection := replace(selection, causes=(*selection.causes, step.selected), fit=fit, gains=gains))
    if periodic.CAUSE.name in selection.causes:
        with criterion.budget.question("which phases the periodic force has together with the other causes"):
            selection = replace(selection, fit=periodic.fit_phases(criterion, selection.fit, settings.PASSES))
    yield (selection := selection.with_fits([selection.fit]))
    search.report(f"selected: {step.selected} (log-likelihood +{first.gain:.0f})")
    if len(selection.causes) > 1:
        with criterion.budget.question("whether each cause is needed together with the later ones"):
            selection = backward(search, selection)
        yield selection


def _revived(criterion: Criterion, fit: Fit) -> Fit:
    """Return the fit with T_A above zero if that is better: errors of a model without the cause may have removed it.

    A lag elsewhere in the loop would otherwise take over its part.
    """
    start = reinitialised(fit.theta)
    if start.T_A == fit.theta.T_A:
        return fit
    again = climb(criterion, start, fit.free)
    return again if again.loglik > fit.loglik else fit


def backward(search: Search, selection: Selection) -> Selection:
    """Remove each cause that would no longer be selected together with the later ones.

    The newest is one of them: it may only have led the others from one maximum to a higher one.
    """
    criterion = search.criterion
    without = partial(fit_without, criterion, passes=search.passes)
    selection = selection.with_fits(criterion.each(partial(without, selection), selection.causes))
    # In the order of selection and one at a time, as in Efroymson's stepwise regression: two causes that replace each
    # other would both go if they were tested against the same model.
    for cause in selection.causes:
        smaller = without(selection, cause)
        selection = selection.with_fits([smaller])
        if superfluous(search, selection, smaller):
            selection = selection.dropping(cause, smaller)
            search.report(f"dropped: {cause} (the others explain it)")
        else:
            selection = replace(selection, gains={**selection.gains, cause: selection.fit.loglik - smaller.loglik})
    return selection
