"""Stepwise selection: which causes the model needs, by the likelihood of all recordings for fitting.

    forward: add the best candidate, if it meets rule 1 -> backward: remove causes that are no longer needed -> repeat
    at the end, for each selected cause: find the causes that explain the data equally well (equivalence.py)

Rule 1: a cause is selected if it raises the log-likelihood by more than LEAST_GAIN, if its strength is inside its
        physical range, and, while more than noise is unexplained, if it explains a fair share of that.  A significant
        but minor effect beside a large unexplained rest is typical of a false name.
Rule 2: the judge recordings are not used here.
Rule 3: a step that exceeds the budget is undone completely, and the search ends with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.diagnose import settings
from twin.diagnose.inference.budget import Spent
from twin.diagnose.inference.fisher_scoring import Fit
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.noise_floor import Floor
from twin.diagnose.search import periodic
from twin.diagnose.search.candidate_fits import climbed, inside, worth_the_whole
from twin.diagnose.search.equivalence import find_classes
from twin.diagnose.search.forward_step import Round, Say, decided, forward
from twin.diagnose.search.state import Selection, material, superfluous, whole, without
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
        quick: skip combinations of causes that explain too little alone, and classes where several causes were found.
        share: smallest part of the unexplained rest that a cause must explain; below LEAST_SHARE more causes are
            selected, too.
        classes: whether to find the equivalence classes; otherwise `find_classes` can do so later.
        say: takes lines of progress.
    """
    found = Selection(base=base, fit=base)
    unanswered = criterion.budget.unanswered
    try:
        _search(criterion, found, floor, candidates, few, quick, share, classes, say)
    except Spent:
        rest = [cause for cause in found.causes if cause not in found.classes]
        if classes and rest and _confounders_asked(rest) not in unanswered:
            unanswered.append(_confounders_asked(rest))
    return found


def _confounders_asked(causes: Sequence[str]) -> str:
    return f"whether others could stand in for {' or '.join(causes)}"


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
) -> None:
    most = settings.MOST_CAUSES if share >= settings.LEAST_SHARE else len(candidates)
    thorough = share == settings.LEAST_SHARE and not quick
    for _ in range(settings.ROUND_TRIPS if thorough and classes else 1):
        passes = settings.PASSES_QUICK if quick else settings.PASSES
        while len(found.causes) < most and _add(criterion, found, floor, candidates, few, share, say, passes):
            pass
        # `_together` continues from a refused step; with MOST_CAUSES there is none.
        if thorough and len(found.causes) < most and material(criterion, found, floor):
            found.become(_together(criterion, found, floor, candidates, few, say))
        if not classes:
            break
        before = set(found.causes)
        _settle(criterion, found, thorough)
        with whole(found), criterion.budget.question(_confounders_asked(found.causes)):
            doubt = floor if thorough else None
            find_classes(criterion, found, doubt, candidates=candidates, few=few, quick=quick, say=say)
        _settle(criterion, found, thorough)
        # A cause that was refused beside a false name may be needed beside the right one.
        if set(found.causes) == before or not material(criterion, found, floor):
            break


def _settle(criterion: Criterion, found: Selection, thorough: bool) -> None:
    """Fit the phases of a periodic force together with all other causes."""
    if thorough and periodic.CAUSE.name in found.causes:
        with whole(found), criterion.budget.question("how the periodic force stands beside the others"):
            found.fit = periodic.settled(criterion, found.fit, settings.PASSES)


def _add(
    criterion: Criterion,
    found: Selection,
    floor: Floor,
    candidates: Sequence[Cause],
    few: int,
    least: float,
    say: Say,
    passes: int = settings.PASSES,
) -> bool:
    """Make a forward step, then remove causes that are no longer needed; False if no cause is selected."""
    with whole(found):
        step = forward(criterion, found.base, found.fit, floor, candidates, few, least, say)
    return _taken(criterion, found, floor, step, say, passes)


def _taken(criterion: Criterion, found: Selection, floor: Floor, step: Round, say: Say, passes: int) -> bool:
    """Apply the result of a forward step; False if it selected nothing."""
    found.rounds.append(step)
    if not step.taken:
        say("none taken" + (f": {step.best.cause}, +{step.best.gain:.1f}, {step.refusal}" if step.best else ""))
        return False
    found.causes.append(step.taken)
    found.fit = step.trials[0].fit
    found.gains[step.taken] = step.trials[0].gain
    if periodic.CAUSE.name in found.causes:
        with whole(found), criterion.budget.question("how the periodic force stands beside the others"):
            found.fit = periodic.rephased(criterion, found.fit, settings.PASSES)
    found.remember(found.fit)
    say(f"taken: {step.taken} (log-likelihood +{step.trials[0].gain:.0f})")
    if len(found.causes) > 1:
        with whole(found), criterion.budget.question("whether each cause is needed beside the later ones"):
            backward(criterion, found, floor, say, passes)
    return True


def _together(
    criterion: Criterion, found: Selection, floor: Floor, candidates: Sequence[Cause], few: int, say: Say
) -> Selection:
    """Add causes that explain too little alone but leave only noise together; otherwise return `found` unchanged.

    Two causes of similar size mask each other: without the second, the first may explain only a tenth.
    """
    refused = found.rounds[-1]
    if len(found.causes) >= settings.MOST_TOGETHER:
        return found
    excess = floor.under(criterion, found.fit.theta).excess(found.fit.loglik)
    if not refused.trials or refused.trials[0].gain < settings.LEAST_SHARE_TOGETHER * excess:
        return found
    say("too little alone; does it, with others, leave nothing but noise?")
    with whole(found), criterion.budget.question("whether several causes explain together what none does"):
        again = _asked_again(criterion, found, floor, refused)
        for first in _firsts(again):
            more = replace(found, causes=[*found.causes], gains={**found.gains}, rounds=found.rounds[:-1])
            goes_on = _taken(criterion, more, floor, first, say, settings.PASSES)
            while goes_on and len(more.causes) < settings.MOST_TOGETHER and material(criterion, more, floor):
                least = (
                    settings.LEAST_SHARE_TOGETHER
                    if len(more.causes) < settings.MOST_TOGETHER - 1
                    else settings.LEAST_SHARE_LAST
                )
                goes_on = _add(criterion, more, floor, candidates, few, least, say)
            if not material(criterion, more, floor):
                return more
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


def backward(criterion: Criterion, found: Selection, floor: Floor, say: Say, passes: int) -> None:
    """Remove each cause that would no longer be selected beside the later ones."""
    criterion.each(lambda cause: without(criterion, found, cause, passes), found.causes[:-1])
    for cause in found.causes[:-1]:
        smaller = without(criterion, found, cause, passes)
        if superfluous(criterion, found, floor, smaller):
            found.causes.remove(cause)
            found.gains.pop(cause, None)
            found.fit = smaller
            say(f"dropped: {cause} (the others explain it)")
        else:
            found.gains[cause] = found.fit.loglik - smaller.loglik
