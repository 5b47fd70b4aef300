"""Stepwise selection: which causes the model needs, by the likelihood of all recordings for fitting.

    forward: add the best candidate, if it meets rule 1 -> backward: remove causes that are no longer needed -> repeat
    at the end, for each selected cause: find the causes that explain the data equally well (equivalence.py)

Rule 1: a cause is selected if it raises the log-likelihood by more than LEAST_GAIN, if its strength is inside its
        physical range, and, while more than noise is unexplained, if it explains a fair share of that.  A significant
        but minor effect beside a large unexplained rest is typical of a false name.
Rule 2: the judge recordings are not used here.
Rule 3: a step that exceeds the budget makes no new selection, and the search ends with the one before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

from twin.diagnose import settings
from twin.diagnose.inference.budget import Spent
from twin.diagnose.inference.fisher_scoring import Fit, climb
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.noise_floor import Floor
from twin.diagnose.inference.theta import reinitialised
from twin.diagnose.search import periodic
from twin.diagnose.search.candidate_fits import climbed, inside, worth_the_whole
from twin.diagnose.search.equivalence import find_classes
from twin.diagnose.search.forward_step import Round, Say, decided, forward
from twin.diagnose.search.state import Selection, material, superfluous, without
from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.cause import Cause


def select(
    criterion: Criterion,
    base: Fit,
    floor: Floor,
    *,
    candidates: Sequence[Cause] = CATALOGUE,
    few: int = settings.CANDIDATES,
    quick: bool = False,
    share: float = settings.LEAST_SHARE,
    classes: bool = True,
    say: Say = lambda line: None,
) -> Selection:
    """Select causes: forward steps, backward steps, equivalence classes.

    Args:
        criterion: of the recordings for fitting.
        base: the model without causes, at its best.
        floor: what sensor noise alone leaves, under any model.
        candidates: the causes to try.
        few: candidates that are fitted in a round.
        quick: skip combinations of causes that explain too little alone, and most of the class search where several
            causes were found.
        share: smallest part of the unexplained rest that a cause must explain; below LEAST_SHARE more causes are
            selected, too.
        classes: whether to find the equivalence classes; otherwise `find_classes` can do so later.
        say: takes lines of progress.
    """
    found = Selection(base=base, fit=base)
    unanswered = criterion.budget.unanswered
    try:
        for after in _search(criterion, found, floor, candidates, few, quick, share, classes, say):
            found = after
    except Spent:
        rest = [cause for cause in found.causes if cause not in found.classes]
        if classes and rest and _confounders_asked(rest) not in unanswered:
            unanswered.append(_confounders_asked(rest))
    return found


def _confounders_asked(causes: Sequence[str]) -> str:
    return f"whether other causes explain as much as {' or '.join(causes)}"


def _search(
    criterion: Criterion,
    found: Selection,
    floor: Floor,
    candidates: Sequence[Cause],
    few: int,
    quick: bool,
    share: float,
    classes: bool,
    say: Say,
) -> Iterator[Selection]:
    """Yield the selection after each step."""
    most = settings.MOST_CAUSES if share >= settings.LEAST_SHARE else len(candidates)
    thorough = share == settings.LEAST_SHARE and not quick
    for _ in range(settings.ROUND_TRIPS if thorough and classes else 1):
        passes = settings.PASSES_QUICK if quick else settings.PASSES
        while len(found.causes) < most:
            for after in _add(criterion, found, floor, candidates, few, share, say, passes):
                yield (found := after)
            if not found.rounds[-1].taken:
                break
        # `_together` continues from a refused step; with MOST_CAUSES there is none.
        if thorough and len(found.causes) < most and material(criterion, found, floor):
            yield (found := _together(criterion, found, floor, candidates, few, say))
        if not classes:
            break
        before = set(found.causes)
        yield (found := _settled(criterion, found, thorough))
        with criterion.budget.question(_confounders_asked(found.causes)):
            doubt = floor if thorough else None
            found = find_classes(criterion, found, doubt, candidates=candidates, few=few, quick=quick, say=say)
        yield found
        yield (found := _settled(criterion, found, thorough))
        # A cause that was refused beside a false name may be needed beside the right one.
        if set(found.causes) == before or not material(criterion, found, floor):
            break


def _settled(criterion: Criterion, found: Selection, thorough: bool) -> Selection:
    """Fit the phases of a periodic force together with all other causes."""
    if not thorough or periodic.CAUSE.name not in found.causes:
        return found
    with criterion.budget.question("which phases the periodic force has beside the others"):
        return replace(found, fit=periodic.settled(criterion, found.fit, settings.PASSES))


def _add(
    criterion: Criterion,
    found: Selection,
    floor: Floor,
    candidates: Sequence[Cause],
    few: int,
    least: float,
    say: Say,
    passes: int = settings.PASSES,
) -> Iterator[Selection]:
    """Make a forward step, then remove causes that are no longer needed; yields the selection after each part."""
    step = forward(criterion, found.base, found.fit, floor, candidates, few, least, say)
    yield from _taken(criterion, found, floor, step, say, passes)


def _taken(
    criterion: Criterion, found: Selection, floor: Floor, step: Round, say: Say, passes: int
) -> Iterator[Selection]:
    """Apply the result of a forward step; yields the selection after each part, unchanged if it selected nothing."""
    found = replace(found, rounds=(*found.rounds, step))
    if not step.taken:
        say("none taken" + (f": {step.best.cause}, +{step.best.gain:.1f}, {step.refusal}" if step.best else ""))
        yield found
        return
    first = step.trials[0]
    gains = {**found.gains, step.taken: first.gain}
    fit = _revived(criterion, first.fit)
    yield (found := replace(found, causes=(*found.causes, step.taken), fit=fit, gains=gains))
    if periodic.CAUSE.name in found.causes:
        with criterion.budget.question("which phases the periodic force has beside the others"):
            found = replace(found, fit=periodic.rephased(criterion, found.fit, settings.PASSES))
    yield (found := found.knowing([found.fit]))
    say(f"taken: {step.taken} (log-likelihood +{first.gain:.0f})")
    if len(found.causes) > 1:
        with criterion.budget.question("whether each cause is needed beside the later ones"):
            found = backward(criterion, found, floor, say, passes)
        yield found


def _revived(criterion: Criterion, fit: Fit) -> Fit:
    """The fit with a T_A that the errors of the model without the cause had driven to zero, if it is wanted back.

    A lag of another place would take over its part.
    """
    start = reinitialised(fit.theta)
    if start.T_A == fit.theta.T_A:
        return fit
    again = climb(criterion, start, fit.free)
    return again if again.loglik > fit.loglik else fit


def _together(
    criterion: Criterion, found: Selection, floor: Floor, candidates: Sequence[Cause], few: int, say: Say
) -> Selection:
    """Add causes that explain too little alone but leave only noise together; otherwise return `found`.

    Two causes of similar size mask each other: without the second, the first may explain only a tenth.
    """
    refused = found.rounds[-1]
    if len(found.causes) >= settings.MOST_TOGETHER:
        return found
    excess = floor.under(criterion, found.fit.theta).excess(found.fit.loglik)
    if not refused.trials or refused.trials[0].gain < settings.LEAST_SHARE_TOGETHER * excess:
        return found
    say("too little alone; does it, with others, leave nothing but noise?")
    with criterion.budget.question("whether several causes explain together what none does"):
        again = _asked_again(criterion, found, floor, refused)
        for first in _firsts(again):
            *_, more = _taken(criterion, replace(found, rounds=found.rounds[:-1]), floor, first, say, settings.PASSES)
            while (
                more.rounds[-1].taken and len(more.causes) < settings.MOST_TOGETHER and material(criterion, more, floor)
            ):
                least = (
                    settings.LEAST_SHARE_TOGETHER
                    if len(more.causes) < settings.MOST_TOGETHER - 1
                    else settings.LEAST_SHARE_LAST
                )
                *_, more = _add(criterion, more, floor, candidates, few, least, say)
            if not material(criterion, more, floor):
                return more
            found = replace(found, smaller=more.smaller)
    return found


def _firsts(again: Round) -> list[Round]:
    """The step, and variants of it with another candidate of nearly the same gain, as a false one may lead narrowly."""
    if not again.taken:
        return []
    firsts = [again]
    for trial in again.trials[1:]:
        near = trial.gain > settings.FIRST_SHARE * again.trials[0].gain and inside(trial)
        if near and all(abs(trial.gain - first.trials[0].gain) > settings.EQUIVALENT_GAIN for first in firsts):
            others = tuple(other for other in again.trials if other is not trial)
            firsts.append(replace(again, trials=(trial, *others), taken=trial.cause, best=trial, instead=True))
    return firsts[: settings.FIRSTS]


def _asked_again(criterion: Criterion, found: Selection, floor: Floor, refused: Round) -> Round:
    """The refused step with a smaller required share, its candidates fitted to the end."""
    least = (
        settings.LEAST_SHARE_TOGETHER if len(found.causes) < settings.MOST_TOGETHER - 1 else settings.LEAST_SHARE_LAST
    )
    trials = [
        trial
        if trial.fit.converged or not worth_the_whole(trial, refused.trials[0])
        else climbed(criterion, trial, settings.PASSES)
        for trial in refused.trials
    ]
    trials.sort(key=lambda trial: -trial.gain)
    under = floor.under(criterion, found.fit.theta)
    return decided(criterion, found.base, found.fit, under, refused.scores, trials, least)


def backward(criterion: Criterion, found: Selection, floor: Floor, say: Say, passes: int) -> Selection:
    """Remove each cause that would no longer be selected beside the later ones."""
    earlier = found.causes[:-1]
    found = found.knowing(criterion.each(partial(without, criterion, found, passes=passes), earlier))
    for cause in earlier:
        smaller = without(criterion, found, cause, passes)
        found = found.knowing([smaller])
        if superfluous(criterion, found, floor, smaller):
            found = found.dropping(cause, smaller)
            say(f"dropped: {cause} (the others explain it)")
        else:
            found = replace(found, gains={**found.gains, cause: found.fit.loglik - smaller.loglik})
    return found
