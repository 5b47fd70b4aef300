"""Equivalence classes: which other causes explain the data as well as a selected one.

    for each selected cause: try every other candidate in its place -> a better one replaces it; equals are its class

Rule: causes whose best fits differ by less than EQUIVALENT_GAIN of log-likelihood are one class.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

from twin.diagnose import settings
from twin.diagnose.inference.fisher_scoring import Fit, climb
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.noise_floor import Floor
from twin.diagnose.inference.theta import parameter_of, prior_spread, reinitialised
from twin.diagnose.search import periodic
from twin.diagnose.search.candidate_fits import Trial, fitted, inside, renamed, rises, same_as
from twin.diagnose.search.candidate_starts import beside
from twin.diagnose.search.forward_step import Say
from twin.diagnose.search.score_test import screen
from twin.diagnose.search.state import Selection, material, superfluous, without
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause


def find_classes(
    criterion: Criterion,
    found: Selection,
    floor: Floor | None = None,
    *,
    candidates: Sequence[Cause] = CATALOGUE,
    few: int = settings.CANDIDATES,
    quick: bool = False,
    say: Say = lambda line: None,
) -> Selection:
    """Find the class of each selected cause and the best candidate outside it; the arguments are those of `select`.

    With `quick` and several causes, the last has the equals of its own forward step, and few candidates are tried in
    the place of the others: those were taken when the later ones were missing.

    With `floor`, if several causes leave more than noise, one of them may be false: the last is examined first, and
    all candidates are fitted, whatever their score.  Beside a friction that is not yet right a true
    cause had a fifteenth of its gain there.
    """

    def doubtful() -> bool:
        return floor is not None and len(found.causes) > 1 and material(criterion, found, floor)

    found = replace(found, classes={}, runner_up={})
    if 1 < len(found.causes) <= settings.MOST_TOGETHER and not quick:
        found = found.knowing(criterion.each(partial(without, criterion, found), found.causes))
    for cause in found.causes[::-1] if doubtful() else found.causes:
        if quick and len(found.causes) > 1 and _is_last(found, cause):
            own = Trial(cause=cause, fit=found.fit, gain=found.gains[cause])
            same = same_as(cause) & {entry.name for entry in candidates}
            equals = [renamed(own, other) for other in sorted(same)] + _equals_when_taken(found, cause, same)
            found = replace(
                found,
                classes={**found.classes, cause: tuple(equals)},
                runner_up={**found.runner_up, cause: found.gains[cause]},
            )
            continue
        most = 1 if quick else few
        found, changed = _class_of(criterion, found, floor, cause, candidates, most, doubtful(), say)
        if changed:
            return find_classes(criterion, found, floor, candidates=candidates, few=few, quick=quick, say=say)
    return found


def _refitted(criterion: Criterion, fit: Fit, cause: str) -> Fit:
    """The better of a fit and one from the usual form of all causes but `cause`.

    Beside the false cause they took a form that made up for its errors.
    """
    others = [name for name in fit.free if math.isfinite(prior_spread(name)) and not name.startswith(cause + ".")]
    if not others:
        return fit
    start = reinitialised(fit.theta)
    for name in others:
        start = start.having(name, parameter_of(name).neutral)
    again = climb(criterion, start, fit.free)
    return again if again.loglik > fit.loglik else fit


def _is_last(found: Selection, cause: str) -> bool:
    """Whether `cause` was taken last: its rivals were fitted beside all others then."""
    return next((step.taken == cause for step in reversed(found.rounds) if step.taken), False)


def _equals_when_taken(found: Selection, cause: str, same: Collection[str]) -> list[Trial]:
    """The candidates that explained as much as the last cause when it was taken: without a further fit."""
    last = next(step for step in reversed(found.rounds) if step.taken == cause)
    least = max(trial.gain for trial in last.trials if trial.cause == cause) - settings.EQUIVALENT_GAIN
    others = (trial for trial in last.trials if trial.cause not in (*found.causes, *same))
    return [trial for trial in others if trial.gain > least and inside(trial)]


def _one_for_two(criterion: Criterion, found: Selection, cause: str, trial: Trial, say: Say) -> Selection | None:
    """Let `trial` replace `cause` and a second cause if it explains as much as both together; None if it does not.

    Two causes that imitate a third are never found superfluous one by one.
    """
    least = found.fit.loglik - settings.EQUIVALENT_GAIN
    others = sorted(set(found.causes) - {cause, trial.cause}, key=lambda name: found.gains[name])

    def less(other: str) -> Fit:
        free = tuple(name for name in trial.fit.free if not name.startswith(other + "."))
        return climb(criterion, reinitialised(trial.fit.theta.without(other)), free)

    for other, fit in zip(others, criterion.each(less, others), strict=True):
        if fit.loglik > least:
            if trial.cause == cause:
                say(f"dropped: {other} ({cause} explains it)")
            else:
                say(f"{trial.cause} explains as much as {cause} and {other} together: it takes their place")
            causes = tuple(trial.cause if name == cause else name for name in found.causes if name != other)
            gain = fit.loglik - found.base.loglik
            gains = {name: found.gains.get(name, gain) for name in causes}
            return replace(found, causes=causes, fit=fit, gains=gains).knowing([fit])
    return None


def _class_of(
    criterion: Criterion,
    found: Selection,
    floor: Floor | None,
    cause: str,
    candidates: Sequence[Cause],
    few: int,
    everyone: bool,
    say: Say,
) -> tuple[Selection, bool]:
    """Find the class of `cause` with the other causes fixed; a candidate that explains more takes its place.

    With `everyone`, candidates are fitted whatever their score.

    Returns the selection, and True if two causes were replaced by one or if `cause` is superfluous; then all classes
    are found again.
    """
    stood = cause
    if len(found.causes) == 1:
        at, known = found.base, {trial.cause: trial for trial in found.rounds[0].trials}
    else:
        at, known = without(criterion, found, cause), {}
        found = found.knowing([at])
    own = Trial(cause=cause, fit=found.fit, gain=found.fit.loglik - at.loglik)
    needless = own.gain < settings.LEAST_GAIN if floor is None else superfluous(criterion, found, floor, at)
    if needless and len(found.causes) > 1:
        say(f"dropped: {cause} (the others explain it)")
        return found.dropping(cause, at), True
    others = [entry for entry in candidates if entry.name not in found.causes]
    scores = screen(criterion, at.theta, at.free, [*others, BY_NAME[cause]])
    shown = {score.cause: score.gain for score in scores}
    comparable = settings.COMPARABLE_SCORE * shown.get(cause, 0.0)
    alike = {name for name, gain in shown.items() if gain > settings.ALIKE_SCORE * shown.get(cause, 0.0)}
    alike |= {entry.name for entry in candidates if entry.family == BY_NAME[cause].family}
    same = same_as(cause) & {entry.name for entry in others}
    scores = [score for score in scores if score.cause not in (*known, cause, *same) and score.testable]
    scores = [score for score in scores if score.gain > 0.3 * settings.LEAST_GAIN]
    if not everyone:
        scores = [
            score
            for score in scores
            if score.gain > comparable
            if score.cause in alike or score.gain * rises(score.cause) > own.gain - settings.OUT_OF_CLASS_GAIN
        ][: max(few - len(known), 2)]
    trials = [trial for trial in known.values() if trial.cause not in (cause, *same)]
    trials += [renamed(own, other) for other in same]
    trials += fitted(criterion, at, scores, beaten=-math.inf if everyone else own.gain - settings.OUT_OF_CLASS_GAIN)
    trials = criterion.each(lambda trial: _again(criterion, own, trial) if trial.cause in alike else trial, trials)
    trials = sorted((trial for trial in trials if inside(trial)), key=lambda trial: -trial.gain)
    shaken = found.gains.get(periodic.CAUSE.name, 0.0) if periodic.AMPLITUDE in at.free else 0.0
    _rephase(criterion, own, trials, alike, shaken)
    trials.sort(key=lambda trial: -trial.gain)
    if trials and trials[0].gain > own.gain + settings.EQUIVALENT_GAIN:
        own = _again(criterion, trials[0], own)
        found = replace(found, fit=own.fit)
    if trials and trials[0].gain > own.gain + settings.EQUIVALENT_GAIN:
        say(f"{trials[0].cause} explains more than {cause} beside the others: it takes its place")
        best = trials[0]
        causes = tuple(best.cause if name == cause else name for name in found.causes)
        if periodic.CAUSE.name in causes:
            fit = periodic.rephased(criterion, best.fit, settings.PASSES)
        else:
            fit = _refitted(criterion, best.fit, best.cause)
        gains = {name: gain for name, gain in {**found.gains, best.cause: best.gain}.items() if name != cause}
        found = replace(found, causes=causes, fit=fit, gains=gains)
        trials = [own, *trials[1:]]
        own, cause = best, best.cause
    near = tuple(trial for trial in trials if own.gain - trial.gain < settings.EQUIVALENT_GAIN)
    far = [trial.gain for trial in trials if own.gain - trial.gain >= settings.EQUIVALENT_GAIN]
    found = replace(
        found,
        classes={**found.classes, cause: near},
        runner_up={**found.runner_up, cause: own.gain - max(far, default=0.0)},
        gains={**found.gains, cause: own.gain},
    )
    for trial in (own, *near):
        less = None if trial.cause in (stood, *same) else _one_for_two(criterion, found, cause, trial, say)
        if less is not None:
            return less, True
    return found, False


def _rephase(criterion: Criterion, own: Trial, trials: list[Trial], alike: set[str], shaken: float) -> None:
    """Fit similar candidates that phases may hold back with phases of their own, in place.

    `alike` are the names of similar candidates, `shaken` is the gain of the periodic force.

    A lag of the sensor shifts the phase of a periodic force as it is read, a lag of the field does not.  On two
    simulated flights the right cause was 990 behind the wrong one with the other's phases, and 110 ahead with its own.
    """
    least, most = own.gain - settings.PHASE_SHARE * shaken, own.gain + settings.EQUIVALENT_GAIN
    behind = [n for n, trial in enumerate(trials) if trial.cause in alike and least < trial.gain < most]
    for n in behind[: settings.PHASE_CANDIDATES] if shaken > 0.0 else ():
        trial = trials[n]
        fit = periodic.settled(criterion, periodic.rephased(criterion, trial.fit, settings.PASSES), settings.PASSES)
        trials[n] = replace(trial, fit=fit, gain=trial.gain + fit.loglik - trial.fit.loglik)


def _again(criterion: Criterion, own: Trial, confounder: Trial) -> Trial:
    """Fit a candidate that is behind once more, from the parameters found with `own`."""
    if own.gain - confounder.gain < settings.EQUIVALENT_GAIN:
        return confounder
    start = beside(criterion.thinner, own.fit.theta, BY_NAME[own.cause], BY_NAME[confounder.cause])
    start = replace(start, phases_s=confounder.fit.theta.phases_s)
    if criterion.value(start) <= confounder.fit.loglik:
        return confounder
    fit = climb(criterion, start, confounder.fit.free)
    if fit.loglik <= confounder.fit.loglik:
        return confounder
    return replace(confounder, fit=fit, gain=confounder.gain + fit.loglik - confounder.fit.loglik)
