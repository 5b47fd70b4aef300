"""Which causes belong into the model: forward by the likelihood of all recordings, backward, and who could stand in.

    screen all -> fit the best few -> take the best if it earns it -> again, until nothing earns it
    then for each cause that was taken: out with it, and who else explains as much?  Those are its class.

Rule 1: a cause earns its place by log-likelihood over THRESHOLD, by a strength inside its physical range, and where the
        model lacks more than noise, by a fair share of what it lacks.  A significant trifle beside a large unexplained
        rest is how a false name looks.
Rule 2: causes whose best fits differ by less than MARGIN of log-likelihood are one class: z = sqrt(2 MARGIN) = 3.
Rule 3: the judge recordings are never looked at here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from twin.diagnose import periodic
from twin.diagnose.estimate import PASSES, Fit, climb
from twin.diagnose.floor import Floor
from twin.diagnose.likelihood import Criterion
from twin.diagnose.payoff import removed
from twin.diagnose.screen import Score, screen
from twin.diagnose.starts import beside, start_of
from twin.diagnose.theta import coordinates_of, parameter_of, roused
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause

THRESHOLD = 10.0  # of log-likelihood: z = 4.5, and more than the most of 30 candidates reaches by chance
TRIFLE = 0.005  # of what the causes found so far gain together: below, it mends how they are written, not the rig
BESIDE_NOISE = 0.1  # the same, once what is left is hardly more than noise
SHARE = 0.2  # of the excess that is left
SHARE_TOGETHER = 0.05  # of the same, where together with others it leaves nothing but noise
SHARE_LAST = 0.8  # of the last of them
MOST_TOGETHER = 3
PAYS = 0.5  # of the mean square error of x 20 ms ahead: a smaller share will do for a cause that removes so much
MARGIN = 4.5
MOST_CAUSES = 4
FEW = 5  # candidates that are fitted in a round
_SHORT = 2  # passes of a first fit
_PASSES_QUICK = 10  # of a model without one of its causes: enough to see that it is worse, hardly by how much
# Then: passes, least share of the best gain, most candidates that go on.
_HEATS = ((4, 0.1, 6), (8, 0.35, 4), (PASSES, 0.5, 4))
_STEEPER = 8.0  # the likelihood of a cause that is far away rises up to five times as much as its slope promises
_FAR_BEHIND = 0.02  # of the best gain on the screen: such a candidate will not be the best
_COMPARABLE = 0.2  # of the cause's own gain on the screen: what stands in for it shows there, too
_ALIKE = 0.8  # of the cause's own gain on the screen: it may do the same, and have begun to climb at a worse place
_FAVOURITES = 2  # best of the screen: they go through the first heat, however slowly they begin to climb
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One candidate, fitted."""

    cause: str
    fit: Fit
    gain: float  # of log-likelihood, against the model without it, beyond what the search makes out of noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One step forward."""

    scores: tuple[Score, ...]
    trials: tuple[Trial, ...]  # best first
    taken: str  # "" where none was
    why: str


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
        stand_ins(criterion, found, candidates=candidates, few=few, quick=quick, say=say)
    return found


def stand_ins(
    criterion: Criterion,
    found: Selection,
    *,
    candidates: Sequence[Cause] = CATALOGUE,
    few: int = FEW,
    quick: bool = False,
    say: Say = lambda line: None,
) -> None:
    """The class of each cause that was found, and who comes next; the arguments are those of `select`."""
    for cause in list(found.causes):
        if quick and len(found.causes) > 1:
            found.runner_up[cause] = found.gains[cause]
            continue
        _rivals(criterion, found, cause, candidates, few, say)


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
    step = _forward(criterion, found.fit, floor, candidates, few, found.fit.loglik - found.base.loglik, least, say)
    found.rounds.append(step)
    if not step.taken:
        return False
    found.causes.append(step.taken)
    found.fit = step.trials[0].fit
    found.gains[step.taken] = step.trials[0].gain
    if periodic.CAUSE.name in found.causes:
        found.fit = periodic.rephased(criterion, found.fit, PASSES)
    say(f"taken: {step.taken} ({step.why})")
    if len(found.causes) > 1:
        _backward(criterion, found, say, passes)
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
    shift_s = criterion.shift_s
    more = replace(found, causes=[*found.causes], gains={**found.gains}, rounds=found.rounds[:-1])
    say("too little alone; does it, with others, leave nothing but noise?")
    while len(more.causes) < MOST_TOGETHER and _material(criterion, more, floor):
        least = SHARE_TOGETHER if len(more.causes) < MOST_TOGETHER - 1 else SHARE_LAST
        if not _add(criterion, more, floor, candidates, few, least, say):
            break
    if _material(criterion, more, floor):
        criterion.shift_s = shift_s
        return found
    return more


def _forward(
    criterion: Criterion,
    at: Fit,
    floor: Floor,
    candidates: Sequence[Cause],
    few: int,
    gained: float,
    least: float,
    say: Say,
) -> Round:
    scores = screen(criterion, at.theta, at.free, candidates)
    if any(cause.name == periodic.CAUSE.name for cause in candidates):
        scores = _with_line(criterion, at, scores)
    gain_least = max(
        0.5 * THRESHOLD, 0.3 * TRIFLE * gained, _FAR_BEHIND * max((score.gain for score in scores), default=0.0)
    )
    floor = floor.under(criterion, at.theta)
    excess = floor.excess(at.loglik)
    if least > SHARE and floor.material(at.loglik):  # so much is asked: no use in fitting what is hopeless
        gain_least = max(gain_least, least * excess / _STEEPER)
    worth = [score for score in scores if score.testable and score.gain - score.chance > gain_least][:few]
    say("screen: " + (", ".join(f"{score.cause} {score.gain:.0f}" for score in worth) or "nothing"))
    pays = PAYS if least <= SHARE else 1.0  # who asks for more of the whole is not content with a part of x
    trials = _fitted(criterion, at, worth, least * excess if floor.material(at.loglik) else 0.0, pays)
    if not trials:
        return Round(scores=tuple(scores), trials=(), taken="", why="nothing in the catalogue gains anything")
    possible = [trial for trial in trials if inside(trial)]
    best = (possible or trials)[0]
    share = best.gain / excess if excess > 0.0 else 1.0
    why = f"log-likelihood +{best.gain:.0f}"
    taken = ""
    if best.gain < THRESHOLD:
        why = f"{best.cause} would be best, with a gain of {best.gain:.1f}: chance does that"
    elif not possible:
        why = f"{best.cause} would be best, but outside its physical range"
    elif best.gain < min(TRIFLE, least) * gained:
        why = f"{best.cause} would be best, but is a trifle beside what was found"
    elif not floor.material(at.loglik) and best.gain < BESIDE_NOISE * gained:
        why = f"{best.cause} would be best, but hardly more than noise is left, and it is a trifle"
    elif floor.material(at.loglik) and share < least and removed(criterion, at.theta, best.fit.theta) < pays:
        why = f"{best.cause} would be best, but explains {100 * share:.0f} % of what is left"
    else:
        taken = best.cause
        trials = [best, *(trial for trial in trials if trial is not best)]
    return Round(scores=tuple(scores), trials=tuple(trials), taken=taken, why=why)


def _with_line(criterion: Criterion, at: Fit, scores: list[Score]) -> list[Score]:
    """The scores with that of the strongest line among them."""
    if any(name == periodic.AMPLITUDE for name, _ in at.theta.causes):
        return scores
    line = periodic.find_line(criterion, at.theta)
    if line is None:
        return scores
    criterion.shift_s = line.shift_s
    score = Score(
        cause=periodic.CAUSE.name,
        probe=line.amplitude_n,
        gain=line.gain,
        step=1.0,
        z=math.sqrt(2.0 * line.gain),
        detectable=math.sqrt(2.0 * line.gain) * periodic.CAUSE.strength.probes[0] / max(line.amplitude_n, 1e-12),
        visible=1.0,
        beside=(),
        chance=line.chance,
        others=((periodic.FREQUENCY, line.frequency_hz),),
    )
    return sorted([*scores, score], key=lambda found: -found.gain)


def _fitted(
    criterion: Criterion, at: Fit, scores: Sequence[Score], wanted: float = 0.0, pays: float = PAYS
) -> list[Trial]:
    """Each candidate fitted, the leading ones to the end; best first.

    Args:
        criterion: of the recordings for fitting.
        at: the model without them.
        scores: the candidates.
        wanted: the gain below which none will be taken, unless it pays in prediction.
        pays: share of the mean square error of a prediction that it must remove then.
    """
    trials = [
        Trial(
            cause=score.cause,
            fit=(
                fit := climb(
                    criterion, start_of(criterion, at.theta, score), _with(at.free, score.cause), passes=_SHORT
                )
            ),
            gain=fit.loglik - at.loglik - score.chance,
        )
        for score in scores
    ]
    trials.sort(key=lambda trial: -trial.gain)
    favourites = {score.cause for score in scores[:_FAVOURITES]}
    for heat, (passes, hopeless, most) in enumerate(_HEATS):
        least = hopeless * trials[0].gain if trials else 0.0
        # Not before: the likelihood of a delay is flat at 0 and rises fifty times as high as its slope there promises.
        last = heat == len(_HEATS) - 1 and bool(trials)
        overtaken = trials[0].gain - MARGIN if last else -math.inf
        if last and all(_promise(trial) < wanted for trial in trials):
            least_pay = 0.5 * pays
            if least_pay >= 0.5 or removed(criterion, at.theta, trials[0].fit.theta) < least_pay:
                break
        for place, trial in enumerate(trials):
            goes_on = place < most and trial.gain >= least and _promise(trial) >= overtaken
            goes_on = goes_on or (heat == 0 and trial.cause in favourites)
            if goes_on and not trial.fit.converged:
                fit = climb(criterion, trial.fit.theta, trial.fit.free, passes=passes)
                trials[place] = replace(trial, fit=fit, gain=trial.gain + fit.loglik - trial.fit.loglik)
        trials.sort(key=lambda trial: -trial.gain)
    return trials


def _promise(trial: Trial) -> float:
    """What a candidate may still reach."""
    return trial.gain if trial.fit.converged else trial.gain + _STEEPER * trial.fit.ahead


def _with(free: tuple[str, ...], cause: str) -> tuple[str, ...]:
    return free + coordinates_of(cause)


def inside(trial: Trial) -> bool:
    """Whether every parameter of the cause is within its physical range, not at its end."""
    for name in coordinates_of(trial.cause):
        parameter = parameter_of(name)
        value = trial.fit.theta.value(name)
        if math.isinf(value):
            return False
        span = parameter.high - parameter.low
        ends = [end for end in (parameter.low, parameter.high) if end != parameter.neutral]
        if any(abs(value - end) < 1e-6 * span for end in ends) and name == coordinates_of(trial.cause)[0]:
            return False
    return True


def _without(criterion: Criterion, fit: Fit, cause: str, passes: int = PASSES) -> Fit:
    free = tuple(name for name in fit.free if not name.startswith(cause + "."))
    return climb(criterion, roused(fit.theta.without(cause)), free, passes=passes)


def _backward(criterion: Criterion, found: Selection, say: Say, passes: int) -> None:
    """Out with whatever the later ones have made superfluous."""
    for cause in found.causes[:-1]:
        smaller = _without(criterion, found.fit, cause, passes)
        loss = found.fit.loglik - smaller.loglik
        if loss < THRESHOLD:
            found.causes.remove(cause)
            found.gains.pop(cause, None)
            found.fit = smaller
            say(f"dropped: {cause} (the others explain it)")
        else:
            found.gains[cause] = loss


def _rivals(
    criterion: Criterion, found: Selection, cause: str, candidates: Sequence[Cause], few: int, say: Say
) -> None:
    """Who could stand in for `cause`, the others staying; a rival that explains more takes its place."""
    if len(found.causes) == 1:
        at, known = found.base, {trial.cause: trial for trial in found.rounds[0].trials}
    else:
        at, known = _without(criterion, found.fit, cause), {}
    own = Trial(cause=cause, fit=found.fit, gain=found.fit.loglik - at.loglik)
    others = [entry for entry in candidates if entry.name not in found.causes]
    scores = screen(criterion, at.theta, at.free, [*others, BY_NAME[cause]])
    shown = {score.cause: score.gain for score in scores}
    comparable = _COMPARABLE * shown.get(cause, 0.0)
    alike = {name for name, gain in shown.items() if gain > _ALIKE * shown.get(cause, 0.0)}
    alike |= {entry.name for entry in candidates if entry.family == BY_NAME[cause].family}
    scores = [
        score
        for score in scores
        if score.cause not in (*known, cause) and score.testable and score.gain > max(0.3 * THRESHOLD, comparable)
    ][: max(few - len(known), 2)]
    trials = [trial for trial in known.values() if trial.cause != cause] + _fitted(criterion, at, scores)
    trials = [_again(criterion, own, trial) if trial.cause in alike else trial for trial in trials]
    trials = sorted((trial for trial in trials if inside(trial)), key=lambda trial: -trial.gain)
    if trials and trials[0].gain > own.gain + MARGIN:
        say(f"{trials[0].cause} explains more than {cause} beside the others: it takes its place")
        best = trials[0]
        found.causes[found.causes.index(cause)] = best.cause
        found.fit, found.gains[best.cause] = best.fit, best.gain
        found.gains.pop(cause, None)
        trials = [own, *trials[1:]]
        own, cause = best, best.cause
    near = tuple(trial for trial in trials if own.gain - trial.gain < MARGIN)
    far = [trial.gain for trial in trials if own.gain - trial.gain >= MARGIN]
    found.classes[cause] = near
    found.runner_up[cause] = own.gain - max(far, default=0.0)
    found.gains[cause] = own.gain


def _again(criterion: Criterion, own: Trial, rival: Trial) -> Trial:
    """A rival that is behind, fitted from the numbers that came out beside `own`."""
    if own.gain - rival.gain < MARGIN:
        return rival
    start = beside(criterion, own.fit.theta, BY_NAME[own.cause], BY_NAME[rival.cause])
    if criterion.value(start) <= rival.fit.loglik:
        return rival
    fit = climb(criterion, start, rival.fit.free)
    if fit.loglik <= rival.fit.loglik:
        return rival
    return replace(rival, fit=fit, gain=rival.gain + fit.loglik - rival.fit.loglik)
