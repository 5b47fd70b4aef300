"""Which causes belong into the model: forward by the likelihood of all recordings, backward, and who could stand in.

    forward: the best cause, if it earns it -> out with whom it makes superfluous -> again, until nothing earns it
    then for each cause that was taken: out with it, and who else explains as much?  Those are its class.

Rule 1: a cause earns its place by log-likelihood over THRESHOLD, by a strength inside its physical range, and where the
        model lacks more than noise, by a fair share of what it lacks.  A significant trifle beside a large unexplained
        rest is how a false name looks.
Rule 2: causes whose best fits differ by less than MARGIN of log-likelihood are one class: z = sqrt(2 MARGIN) = 3.
Rule 3: the judge recordings are never looked at here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from twin.diagnose import periodic
from twin.diagnose.estimate import PASSES, Fit, climb
from twin.diagnose.floor import Floor
from twin.diagnose.forward import BESIDE_NOISE, SHARE, THRESHOLD, Round, Say, decided, forward
from twin.diagnose.likelihood import Criterion
from twin.diagnose.screen import screen
from twin.diagnose.starts import beside
from twin.diagnose.theta import roused
from twin.diagnose.trials import MARGIN, Trial, climbed, fitted, inside, renamed, rises, same_as, worth_the_whole
from twin.identify.record import FloatArray
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause

SHARE_TOGETHER = 0.05  # of what is left, where together with others it leaves nothing but noise
SHARE_LAST = 0.8  # of the last of them
MOST_TOGETHER = 3
MOST_CAUSES = 4
FEW = 5  # candidates that are fitted in a round
_PASSES_QUICK = 10  # of a model without one of its causes: enough to see that it is worse, hardly by how much
_CLEAR = 60.0  # of log-likelihood: a rival so far behind is out, whatever more he gains
_COMPARABLE = 0.2  # of the cause's own gain on the screen: what stands in for it shows there, too
_NEARLY = 0.7  # of the best gain: one of two that hide each other may be behind a false one
_FIRSTS = 4  # such that are tried
_ALIKE = 0.8  # of the cause's own gain on the screen: it may do the same, and have begun to climb at a worse place


@dataclass(slots=True, kw_only=True)
class Selection:
    """The causes in the order in which they were taken, and everything that was tried."""

    base: Fit
    fit: Fit
    causes: list[str] = field(default_factory=list)
    gains: dict[str, float] = field(default_factory=dict)
    classes: dict[str, tuple[Trial, ...]] = field(default_factory=dict)  # rivals within MARGIN
    runner_up: dict[str, float] = field(default_factory=dict)  # lead over the best rival outside the class
    rounds: list[Round] = field(default_factory=list)
    # Models of fewer causes by what is free in them, each with the phases of periodic forces that it was fitted with.
    smaller: dict[frozenset[str], tuple[Fit, FloatArray]] = field(default_factory=dict)

    def remember(self, fit: Fit, criterion: Criterion) -> None:
        """Keep a fit for `recall`."""
        self.smaller[frozenset(fit.free)] = fit, criterion.shift_s

    def recall(self, free: Sequence[str], criterion: Criterion) -> Fit | None:
        """The fit of these numbers, where one is known and its phases are those of today."""
        fit, shift_s = self.smaller.get(frozenset(free), (None, criterion.shift_s))
        return fit if shift_s is criterion.shift_s or periodic.AMPLITUDE not in free else None


def select(
    criterion: Criterion,
    base: Fit,
    floor: Floor,
    *,
    candidates: Sequence[Cause] = CATALOGUE,
    few: int = FEW,
    quick: bool = False,
    share: float = SHARE,
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
        quick: leaves out causes that only count together, and stand-ins for one of several.
        share: least part of what is left that a cause must explain; below SHARE more causes are taken, too.
        classes: whether stand-ins are looked for; else `stand_ins` may be asked later.
        say: takes lines of progress.
    """
    found = Selection(base=base, fit=base)
    most = MOST_CAUSES if share >= SHARE else len(candidates)
    while len(found.causes) < most and _add(
        criterion, found, floor, candidates, few, share, say, _PASSES_QUICK if quick else PASSES
    ):
        pass
    if share == SHARE and not quick and _material(criterion, found, floor):
        found = _together(criterion, found, floor, candidates, few, say)
    if classes:
        asks = floor if share == SHARE and not quick else None
        stand_ins(criterion, found, asks, candidates=candidates, few=few, quick=quick, say=say)
    return found


def stand_ins(
    criterion: Criterion,
    found: Selection,
    floor: Floor | None = None,
    *,
    candidates: Sequence[Cause] = CATALOGUE,
    few: int = FEW,
    quick: bool = False,
    say: Say = lambda line: None,
) -> None:
    """The class of each cause that was found, and who comes next; the arguments are those of `select`.

    With `floor`, where several causes leave more than noise, one of them may be false: the last is asked first, and
    rivals are fitted however little the screen gives them.  Beside a friction that is not yet right a true cause had
    a fifteenth of its gain there.
    """

    def doubtful() -> bool:
        return floor is not None and len(found.causes) > 1 and _material(criterion, found, floor)

    if 1 < len(found.causes) <= MOST_TOGETHER and not quick:
        criterion.each(lambda cause: _without(criterion, found, cause), found.causes)
    for cause in found.causes[::-1] if doubtful() else list(found.causes):
        if quick and len(found.causes) > 1:
            found.runner_up[cause] = found.gains[cause]
            own = Trial(cause=cause, fit=found.fit, gain=found.gains[cause])
            same = same_as(cause) & {entry.name for entry in candidates}
            found.classes[cause] = tuple(renamed(own, other) for other in sorted(same))
        elif _rivals(criterion, found, cause, candidates, few, doubtful(), say):
            found.classes, found.runner_up = {}, {}
            return stand_ins(criterion, found, floor, candidates=candidates, few=few, say=say)


def _add(
    criterion: Criterion,
    found: Selection,
    floor: Floor,
    candidates: Sequence[Cause],
    few: int,
    least: float,
    say: Say,
    passes: int = PASSES,
) -> bool:
    """One step forward, and out with what it makes superfluous (`passes` tell); False where nothing earns its place."""
    gained = found.fit.loglik - found.base.loglik
    step = forward(criterion, found.fit, floor, candidates, few, gained, least, say)
    return _taken(criterion, found, floor, step, say, passes)


def _taken(criterion: Criterion, found: Selection, floor: Floor, step: Round, say: Say, passes: int) -> bool:
    """`_add` after a round."""
    found.rounds.append(step)
    if not step.taken:
        say(f"none taken: {step.why}")
        return False
    found.causes.append(step.taken)
    found.fit = step.trials[0].fit
    found.gains[step.taken] = step.trials[0].gain
    if periodic.CAUSE.name in found.causes:
        found.fit = periodic.rephased(criterion, found.fit, PASSES)
    found.remember(found.fit, criterion)
    say(f"taken: {step.taken} ({step.why})")
    if len(found.causes) > 1:
        _backward(criterion, found, floor, say, passes)
    return True


def _material(criterion: Criterion, found: Selection, floor: Floor) -> bool:
    return floor.under(criterion, found.fit.theta).material(found.fit.loglik)


def _together(
    criterion: Criterion, found: Selection, floor: Floor, candidates: Sequence[Cause], few: int, say: Say
) -> Selection:
    """`found` with causes that alone explain too little and together leave nothing but noise; else `found` as it is.

    Two causes of one size hide each other: without the second, the first explains a tenth.
    """
    refused = found.rounds[-1]
    excess = floor.under(criterion, found.fit.theta).excess(found.fit.loglik)
    if not refused.trials or refused.trials[0].gain < SHARE_TOGETHER * excess:
        return found
    say("too little alone; does it, with others, leave nothing but noise?")
    again = _asked_again(criterion, found, floor, refused)
    for first in _firsts(again):
        shift_s = criterion.shift_s
        more = replace(found, causes=[*found.causes], gains={**found.gains}, rounds=found.rounds[:-1])
        goes_on = _taken(criterion, more, floor, first, say, PASSES)
        while goes_on and len(more.causes) < MOST_TOGETHER and _material(criterion, more, floor):
            least = SHARE_TOGETHER if len(more.causes) < MOST_TOGETHER - 1 else SHARE_LAST
            goes_on = _add(criterion, more, floor, candidates, few, least, say)
        if not _material(criterion, more, floor):
            return more
        criterion.shift_s = shift_s
    return found


def _firsts(again: Round) -> list[Round]:
    """The round, and the same with another cause taken that gains nearly as much: a false one may lead by little."""
    if not again.taken:
        return []
    firsts = [again]
    for trial in again.trials[1:]:
        near = trial.gain > _NEARLY * again.trials[0].gain and inside(trial)
        if near and all(abs(trial.gain - first.trials[0].gain) > MARGIN for first in firsts):
            others = tuple(other for other in again.trials if other is not trial)
            why = f"instead, log-likelihood +{trial.gain:.0f}"
            firsts.append(replace(again, trials=(trial, *others), taken=trial.cause, why=why))
    return firsts[:_FIRSTS]


def _asked_again(criterion: Criterion, found: Selection, floor: Floor, refused: Round) -> Round:
    """The round that took nothing, with a smaller share to ask for; what was not worth the whole climb has it now."""
    least = SHARE_TOGETHER if len(found.causes) < MOST_TOGETHER - 1 else SHARE_LAST
    trials = [
        trial
        if trial.fit.converged or not worth_the_whole(trial, refused.trials[0])
        else climbed(criterion, trial, PASSES)
        for trial in refused.trials
    ]
    trials.sort(key=lambda trial: -trial.gain)
    gained = found.fit.loglik - found.base.loglik
    under = floor.under(criterion, found.fit.theta)
    return decided(criterion, found.fit, under, refused.scores, trials, gained, least)


def _without(criterion: Criterion, found: Selection, cause: str, passes: int = PASSES) -> Fit:
    """The model that was found less one cause; known where the search came that way, or was asked before."""
    free = tuple(name for name in found.fit.free if not name.startswith(cause + "."))
    known = found.recall(free, criterion)
    if known is not None and (known.converged or known.ahead < MARGIN):
        return known
    start = roused(found.fit.theta.without(cause)) if known is None else known.theta
    fit = climb(criterion, start, free, passes=passes)
    found.remember(fit, criterion)
    return fit


def _backward(criterion: Criterion, found: Selection, floor: Floor, say: Say, passes: int) -> None:
    """Out with whatever the later ones have made superfluous: what would not be taken now is not kept."""
    criterion.each(lambda cause: _without(criterion, found, cause, passes), found.causes[:-1])
    for cause in found.causes[:-1]:
        smaller = _without(criterion, found, cause, passes)
        loss = found.fit.loglik - smaller.loglik
        trifle = loss < BESIDE_NOISE * (found.fit.loglik - found.base.loglik)
        if loss < THRESHOLD or (trifle and not floor.under(criterion, smaller.theta).material(smaller.loglik)):
            found.causes.remove(cause)
            found.gains.pop(cause, None)
            found.fit = smaller
            say(f"dropped: {cause} (the others explain it)")
        else:
            found.gains[cause] = loss


def _one_for_two(criterion: Criterion, found: Selection, cause: str, trial: Trial, say: Say) -> bool:
    """Whether `trial`, which may stand in for `cause`, explains as much as that and another together; then it does.

    Two that stand in for a third are never superfluous one by one.
    """
    least = found.fit.loglik - MARGIN
    others = sorted(set(found.causes) - {cause, trial.cause}, key=lambda name: found.gains[name])

    def without(other: str) -> Fit:
        free = tuple(name for name in trial.fit.free if not name.startswith(other + "."))
        return climb(criterion, roused(trial.fit.theta.without(other)), free)

    for other, fit in zip(others, criterion.each(without, others), strict=True):
        if fit.loglik > least:
            say(f"{trial.cause} explains as much as {cause} and {other} together: it takes their place")
            found.causes = [name for name in found.causes if name not in (cause, other)] + [trial.cause]
            found.fit, gain = fit, fit.loglik - found.base.loglik
            found.gains = {name: found.gains.get(name, gain) for name in found.causes}
            found.remember(fit, criterion)
            return True
    return False


def _rivals(
    criterion: Criterion,
    found: Selection,
    cause: str,
    candidates: Sequence[Cause],
    few: int,
    everyone: bool,
    say: Say,
) -> bool:
    """Who could stand in for `cause`, the others staying; a rival that explains more takes its place.

    With `everyone`, none is spared for what the screen gives it.

    True where one took the place of `cause` and another, or where it turns out superfluous: all others are to be asked
    again.
    """
    stood = cause
    if len(found.causes) == 1:
        at, known = found.base, {trial.cause: trial for trial in found.rounds[0].trials}
    else:
        at, known = _without(criterion, found, cause), {}
    own = Trial(cause=cause, fit=found.fit, gain=found.fit.loglik - at.loglik)
    if own.gain < THRESHOLD and len(found.causes) > 1:
        found.causes.remove(cause)
        found.gains.pop(cause)
        found.fit = at
        say(f"dropped: {cause} (the others explain it)")
        return True
    others = [entry for entry in candidates if entry.name not in found.causes]
    scores = screen(criterion, at.theta, at.free, [*others, BY_NAME[cause]])
    shown = {score.cause: score.gain for score in scores}
    comparable = _COMPARABLE * shown.get(cause, 0.0)
    alike = {name for name, gain in shown.items() if gain > _ALIKE * shown.get(cause, 0.0)}
    alike |= {entry.name for entry in candidates if entry.family == BY_NAME[cause].family}
    same = same_as(cause) & {entry.name for entry in others}
    scores = [score for score in scores if score.cause not in (*known, cause, *same) and score.testable]
    scores = [score for score in scores if score.gain > 0.3 * THRESHOLD]
    if not everyone:
        scores = [
            score
            for score in scores
            if score.gain > comparable
            if score.cause in alike or score.gain * rises(score.cause) > own.gain - _CLEAR
        ][: max(few - len(known), 2)]
    trials = [trial for trial in known.values() if trial.cause not in (cause, *same)]
    trials += [renamed(own, other) for other in same]
    trials += fitted(criterion, at, scores, beaten=-math.inf if everyone else own.gain - _CLEAR)
    trials = criterion.each(lambda trial: _again(criterion, own, trial) if trial.cause in alike else trial, trials)
    trials = sorted((trial for trial in trials if inside(trial)), key=lambda trial: -trial.gain)
    if trials and trials[0].gain > own.gain + MARGIN:
        own = _again(criterion, trials[0], own)
        found.fit = own.fit
    if trials and trials[0].gain > own.gain + MARGIN:
        say(f"{trials[0].cause} explains more than {cause} beside the others: it takes its place")
        best = trials[0]
        found.causes[found.causes.index(cause)] = best.cause
        found.fit, found.gains[best.cause] = best.fit, best.gain
        if periodic.CAUSE.name in found.causes:
            found.fit = periodic.rephased(criterion, found.fit, PASSES)
        found.gains.pop(cause, None)
        trials = [own, *trials[1:]]
        own, cause = best, best.cause
    near = tuple(trial for trial in trials if own.gain - trial.gain < MARGIN)
    far = [trial.gain for trial in trials if own.gain - trial.gain >= MARGIN]
    found.classes[cause] = near
    found.runner_up[cause] = own.gain - max(far, default=0.0)
    found.gains[cause] = own.gain
    news = [trial for trial in (own, *near) if trial.cause not in (stood, *same)]
    return any(_one_for_two(criterion, found, cause, trial, say) for trial in news)


def _again(criterion: Criterion, own: Trial, rival: Trial) -> Trial:
    """Who is behind, fitted from the numbers that came out beside `own`."""
    if own.gain - rival.gain < MARGIN:
        return rival
    start = beside(criterion, own.fit.theta, BY_NAME[own.cause], BY_NAME[rival.cause])
    if criterion.value(start) <= rival.fit.loglik:
        return rival
    fit = climb(criterion, start, rival.fit.free)
    if fit.loglik <= rival.fit.loglik:
        return rival
    return replace(rival, fit=fit, gain=rival.gain + fit.loglik - rival.fit.loglik)
