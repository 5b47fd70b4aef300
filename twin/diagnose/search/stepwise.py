"""Which causes belong into the model: forward by the likelihood of all recordings, backward, and classes.

    forward: the best cause, if it earns it -> out with those that it makes superfluous -> again, until nothing earns it
    then for each cause that was taken: what else explains as much?  (equivalence.py)

Rule 1: a cause earns its place by log-likelihood over LEAST_GAIN, by a strength inside its physical range, and where
        the model lacks more than noise, by a fair share of what it lacks.  A significant but minor effect beside a
        large unexplained rest is how a false name looks.
Rule 2: the judge recordings are never looked at here.
Rule 3: a step is made whole or not at all: the first that the budget does not pay to its end is undone, and ends it.
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
    """Forward, backward, classes.

    Args:
        criterion: of the recordings for fitting.
        base: the model without causes, at its best.
        floor: what sensor noise alone leaves, under any model.
        candidates: the causes to try.
        few: candidates that are fitted in a round.
        quick: leaves out causes that only count together, and confounders for one of several.
        share: least part of what is left that a cause must explain; below LEAST_SHARE more causes are taken, too.
        classes: whether confounders are looked for; else `find_classes` may be asked later.
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
        while len(found.causes) < most and _add(
            criterion, found, floor, candidates, few, share, say, settings.PASSES_QUICK if quick else settings.PASSES
        ):
            pass
        # With the most causes there is no refused round, whose trials `_together` takes up.
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
        # What was refused beside a false name may be what is missing beside the right one.
        if set(found.causes) == before or not material(criterion, found, floor):
            break


def _settle(criterion: Criterion, found: Selection, thorough: bool) -> None:
    """The phases of a periodic force as they are beside all others."""
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
    """One step forward, and out with what it makes superfluous (`passes` tell); False where nothing earns its place."""
    gained = found.fit.loglik - found.base.loglik
    with whole(found):
        step = forward(criterion, found.fit, floor, candidates, few, gained, least, say)
    return _taken(criterion, found, floor, step, say, passes)


def _taken(criterion: Criterion, found: Selection, floor: Floor, step: Round, say: Say, passes: int) -> bool:
    """`_add` after a round."""
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
    """`found` with causes that alone explain too little and together leave nothing but noise; else `found` as it is.

    Two causes of one size hide each other: without the second, the first explains a tenth.
    """
    refused = found.rounds[-1]
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
    """The round, and the same with another cause taken that gains nearly as much: a false one may lead by little."""
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
    """The round that took nothing, with a smaller share to ask for; what was not worth the whole climb has it now."""
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
    gained = found.fit.loglik - found.base.loglik
    under = floor.under(criterion, found.fit.theta)
    return decided(criterion, found.fit, under, refused.scores, trials, gained, least)


def backward(criterion: Criterion, found: Selection, floor: Floor, say: Say, passes: int) -> None:
    """Out with whatever the later ones have made superfluous: what would not be taken now is not kept."""
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
