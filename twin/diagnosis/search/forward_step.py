"""A forward step: score all candidates, fit the leading ones, and select the best if it meets the criteria."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twin.diagnosis.search import periodic
from twin.diagnosis.search.candidate_fits import Trial, fit_candidates, steepness, within_range
from twin.diagnosis.search.line_place import place_lead
from twin.diagnosis.search.prediction_benefit import error_reduction
from twin.diagnosis.search.score_test import Score, probed, screen
from twin.diagnosis.search.sensor_line import line_scores
from twin.diagnosis.search.task import Search
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor, part_logliks
from twin.model.causes.catalogue import BY_NAME, with_trait
from twin.settings import diagnosis as settings

# A ball held by friction is predicted well whatever the model lacks, so prediction is not evidence for friction.
HOLDS = with_trait("sticks")
Refusal = Literal["", "chance", "outside its range", "minor", "minor beside noise", "small share"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """The result of a forward step."""

    scores: tuple[Score, ...]
    trials: tuple[Trial, ...]  # best first
    selected: str  # "" if no cause was selected
    best: Trial | None = None  # the trial that was examined; None if nothing was fitted
    share: float = 1.0  # of what is missing, that the best explains (`_share`)
    refusal: Refusal = ""  # of the best
    partner: str = ""  # the cause that was selected with it, as neither explains enough alone


def forward(search: Search, base: Fit, current: Fit) -> Round:
    """Find the best candidate and decide whether to select it.

    Args:
        search: the data and the candidates.
        base: the model without causes.
        current: the model so far, at its best.
    """
    criterion, min_share = search.criterion, search.min_share
    with criterion.budget.question("what else of the catalogue explains what is left"):
        scores = screen(criterion, current.theta, current.free, search.candidates)
        # Periodic forces and lines are scored from spectra.  At zero amplitude a frequency has no slope, so a probe at
        # one frequency would miss all others.
        if any(cause.name == periodic.CAUSE.name for cause in search.candidates):
            force = periodic.score(criterion, current.theta)
            if force is not None:
                frequency_hz = dict(force.other_values)[periodic.FREQUENCY]
                if place_lead(criterion, current.theta, force.cause, frequency_hz) > settings.EQUIVALENT_GAIN:
                    scores = sorted([*scores, force], key=lambda entry: -entry.gain)
        lines = line_scores(criterion, current, search.candidates)
        scores = sorted([*scores, *lines], key=lambda entry: -entry.gain) if lines else scores
        scores = _with_dead_time(criterion, current, scores)
        floor = search.floor.under(criterion, current.theta)
    excess, material = floor.excess(current.loglik), floor.material(current.loglik)
    # Candidates that cannot reach the required share are not fitted.
    min_gain = _minor_gain(floor, base, current, min_share)
    if min_share > settings.MIN_SHARE and material:
        min_gain = max(min_gain, min_share * excess)
    # A share of the best score, too: beside a strong candidate a weak one loses, and the next round asks for it again.
    min_score = max(
        settings.MIN_SCORE * settings.MIN_GAIN,
        settings.MIN_SCORE_SHARE * max((score.gain for score in scores), default=0.0),
    )
    chosen = [
        score
        for score in scores
        # A likelihood rises at most `steepness` times what its slope promises, so this bar keeps all that could reach
        # `min_gain`.
        if score.testable and score.gain - score.chance > max(min_score, min_gain / steepness(score.cause))
    ][: search.max_candidates]
    search.report("screen: " + (", ".join(f"{score.cause} {score.gain:.0f}" for score in chosen) or "nothing"))
    names = ", ".join(score.cause for score in chosen)
    with criterion.budget.question(f"the fit of {len(chosen)} candidates ({names})"):
        parts = floor.lacking(part_logliks(criterion, current.theta)[0], len(criterion.evidence.statics))
        trials = fit_candidates(
            criterion,
            current,
            chosen,
            min_share * min(excess, *parts) if material else 0.0,
            _required_reduction(min_share),
        )
        trials = _with_next(search, floor, trials)
        # For the leading candidate alone: phases for each of them would cost a fit more for each.
        if trials and any(name == periodic.AMPLITUDE for name, _ in current.theta.causes):
            # A cause that delays the response also shifts the phase of the periodic force: fit the phase again.
            fit = periodic.fit_phases(criterion, trials[0].fit, settings.PASSES)
            trials[0] = replace(trials[0], fit=fit, gain=trials[0].gain + fit.loglik - trials[0].fit.loglik)
        step = decide(criterion, base, current, floor, scores, trials, min_share)
    return step


def _with_next(search: Search, floor: Floor, trials: list[Trial]) -> list[Trial]:
    """Put first the trial that explains most together with the best next cause, of those that gain nearly as much."""
    criterion = search.criterion
    possible = {trial.fit.loglik: trial for trial in reversed(trials) if within_range(trial)}.values()  # one per fit
    best = max(possible, key=lambda trial: trial.gain, default=None)
    # Beside a large rest, the gains of two candidates are those of wrong models, and a few percent decide nothing.
    if best is None or not floor.material(best.fit.loglik):
        return trials
    leaders = [trial for trial in possible if trial.gain > settings.LEADERS_SHARE * best.gain]
    if len(leaders) < 2:
        return trials

    def with_next(trial: Trial) -> float:
        scores = screen(criterion, trial.fit.theta, trial.fit.free, search.candidates)
        following = max((score.gain - score.chance for score in scores if score.testable), default=0.0)
        # A score is the gain of a parabola: no cause explains more than what is missing, and that may be a stop's place
        # alone.  A further name costs what a name must gain.
        return trial.gain + max(min(following - settings.MIN_GAIN, floor.excess(trial.fit.loglik)), 0.0)

    first = max(leaders, key=with_next)
    return [first, *(trial for trial in trials if trial is not first)]


def decide(
    criterion: Criterion,
    base: Fit,
    current: Fit,
    floor: Floor,
    scores: Sequence[Score],
    trials: list[Trial],
    min_share: float,
) -> Round:
    """Decide whether the best trial is selected; `base` has no causes, `floor` is that of `current`."""
    if not trials:
        return Round(scores=tuple(scores), trials=(), selected="")
    min_reduction = _required_reduction(min_share)
    possible = [trial for trial in trials if within_range(trial)]
    # Only the best is judged.  A weaker candidate in place of a refused better one would be a name that explains less.
    best = (possible or trials)[0]
    # The conditions go from the cheap and general to the one that may need predictions; the first that fails is
    # reported.
    share = _share(criterion, base, current, floor, best)
    refusal: Refusal = ""
    if best.gain < settings.MIN_GAIN:
        refusal = "chance"
    elif not possible:
        refusal = "outside its range"
    elif best.gain < _minor_gain(floor, base, current, min_share):
        refusal = "minor" if floor.material(current.loglik) else "minor beside noise"
    elif (
        floor.material(current.loglik)
        and share < min_share
        and not _improves_prediction(criterion, current, best, min_reduction)
    ):
        refusal = "small share"
    else:
        trials = [best, *(trial for trial in trials if trial is not best)]
    return Round(
        scores=tuple(scores),
        trials=tuple(trials),
        selected="" if refusal else best.cause,
        best=best,
        share=share,
        refusal=refusal,
    )


def _minor_gain(floor: Floor, base: Fit, current: Fit, min_share: float) -> float:
    """Return the gain below which an effect is minor, by what the model without causes lacks."""
    gained = current.loglik - base.loglik
    # What is still missing counts, too: beside a large unknown rest a small effect is hardly ever what its name says.
    if floor.material(current.loglik):
        return min(settings.MINOR_SHARE, min_share) * (gained + floor.excess(current.loglik))
    return settings.MINOR_SHARE_AT_NOISE * gained


def _share(criterion: Criterion, base: Fit, current: Fit, floor: Floor, best: Trial) -> float:
    """Return the share of what is missing that the best explains, in the part of the data in which it gains most.

    A lack in the other parts is not evidence against it.  If this part lacks hardly more than noise, the share is 1,
    unless the effect is minor compared with those selected before.
    """
    none, before, after = part_logliks(criterion, base.theta, current.theta, best.fit.theta)
    gains, points = after - before, len(criterion.evidence.statics)
    # The part with the largest gain, not the sum over all: a noisy current would hide that a law of the force explains
    # all that the position lacks.
    part = int(np.argmax(gains))
    # A finite lack is one beyond the uncertainty of the noise, so that a share of it means something.
    if np.isfinite(floor.lacking(before, points)[part]):
        # What is left is measured by the floor of the model with the cause: what it says is random cannot be explained.
        left = floor.under(criterion, best.fit.theta).part_excess(after, points)[part]
        return float(gains[part] / (gains[part] + max(left, 0.0)))
    if gains[part] > settings.MINOR_SHARE_AT_NOISE * (before - none)[part]:
        return 1.0
    excess = floor.excess(current.loglik)
    return best.gain / excess if excess > 0.0 else 1.0


def _improves_prediction(criterion: Criterion, current: Fit, best: Trial, min_reduction: float) -> bool:
    return best.cause not in HOLDS and error_reduction(criterion, current.theta, best.fit.theta) >= min_reduction


def _required_reduction(min_share: float) -> float:
    """Return the prediction benefit that replaces the required share; 1 (never) if more than MIN_SHARE is required."""
    return settings.MIN_BENEFIT if min_share <= settings.MIN_SHARE else 1.0


def _with_dead_time(criterion: Criterion, current: Fit, scores: list[Score]) -> list[Score]:
    """Raise the scores of delays to the gain at the delay that the step responses show, where that is larger."""
    delays = [score for score in scores if "delays" in BY_NAME[score.cause].traits and score.testable]
    start = criterion.dead_time if delays else None
    if start is None:
        return scores
    delay_s, T_A = start
    raised = {}
    for score in delays:
        theta = probed(current.theta.having("T_A", T_A), BY_NAME[score.cause], delay_s)
        # The likelihood of a delay is flat at zero, so its slope there says nothing.  One run at the delay that the
        # step responses show costs less than probes at many delays.
        gain = criterion.value(theta) - current.loglik
        if gain > score.gain:
            raised[score.cause] = replace(
                score,
                probe=delay_s,
                gain=gain,
                step=1.0,
                z=math.sqrt(2.0 * gain),
                moves=(),
                other_values=(("T_A", T_A),),
            )
    return sorted((raised.get(score.cause, score) for score in scores), key=lambda entry: -entry.gain)
