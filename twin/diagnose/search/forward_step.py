"""One forward step: score all candidates, fit the best few, and select the best if it meets the criteria."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twin.diagnose import settings
from twin.diagnose.inference.fisher_scoring import Fit
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.noise_floor import Floor, by_part
from twin.diagnose.search import periodic
from twin.diagnose.search.candidate_fits import Trial, fitted, inside, rises
from twin.diagnose.search.prediction_benefit import removed
from twin.diagnose.search.score_test import Score, probed, screen
from twin.model.causes.catalogue import BY_NAME, with_trait
from twin.model.causes.cause import Cause

# A ball held by friction is predicted well whatever the model lacks, so prediction is no evidence for friction.
HOLDS = with_trait("sticks")
Say = Callable[[str], None]
Refusal = Literal["", "chance", "outside its range", "minor", "minor beside noise", "small share"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """The result of a forward step."""

    scores: tuple[Score, ...]
    trials: tuple[Trial, ...]  # best first
    taken: str  # "" where none was
    best: Trial | None = None  # what was judged; None where nothing was fitted
    share: float = 1.0  # of what is missing, that the best explains (`_share`)
    refusal: Refusal = ""  # of the best
    instead: bool = False  # taken on trial in the place of one that gains more


def forward(
    criterion: Criterion,
    base: Fit,
    at: Fit,
    floor: Floor,
    candidates: Sequence[Cause],
    few: int,
    least: float,
    say: Say,
) -> Round:
    """Find the best candidate and decide whether to select it.

    Args:
        criterion: of the recordings for fitting.
        base: the model without causes.
        at: the model so far, at its best.
        floor: noise floor of the log-likelihood.
        candidates: the causes to try.
        few: number of candidates to fit.
        least: share of the unexplained rest that a cause must explain.
        say: takes lines of progress.
    """
    with criterion.budget.question("what else of the catalogue explains what is left"):
        scores = screen(criterion, at.theta, at.free, candidates)
        if any(cause.name == periodic.CAUSE.name for cause in candidates):
            scores = _with_line(criterion, at, scores)
        scores = _with_dead_time(criterion, at, scores)
        floor = floor.under(criterion, at.theta)
    excess, material, gained = floor.excess(at.loglik), floor.material(at.loglik), at.loglik - base.loglik
    # Candidates that cannot reach the required share are not fitted.
    wanted = (min(settings.MINOR_SHARE, least) if material else settings.MINOR_SHARE_AT_NOISE) * gained
    if least > settings.LEAST_SHARE and material:
        wanted = max(wanted, least * excess)
    gain_least = max(
        0.5 * settings.LEAST_GAIN, settings.LEAST_SCORE_SHARE * max((score.gain for score in scores), default=0.0)
    )
    worth = [
        score
        for score in scores
        if score.testable and score.gain - score.chance > max(gain_least, wanted / rises(score.cause))
    ][:few]
    say("screen: " + (", ".join(f"{score.cause} {score.gain:.0f}" for score in worth) or "nothing"))
    names = ", ".join(score.cause for score in worth)
    with criterion.budget.question(f"the fit of {len(worth)} candidates ({names})"):
        parts = floor.lacking(by_part(criterion, at.theta)[0], len(criterion.evidence.statics))
        trials = fitted(criterion, at, worth, least * min(excess, *parts) if material else 0.0, _pays(least))
        if trials and any(name == periodic.AMPLITUDE for name, _ in at.theta.causes):
            # A cause that delays the response also shifts the phase of the periodic force: fit the phase again.
            fit = periodic.rephased(criterion, trials[0].fit, settings.PASSES)
            trials[0] = replace(trials[0], fit=fit, gain=trials[0].gain + fit.loglik - trials[0].fit.loglik)
        step = decided(criterion, base, at, floor, scores, trials, least)
    return step


def decided(
    criterion: Criterion,
    base: Fit,
    at: Fit,
    floor: Floor,
    scores: Sequence[Score],
    trials: list[Trial],
    least: float,
) -> Round:
    """Decide whether the best trial is selected; `base`: no causes, `at`: those so far, `floor` is that of `at`."""
    if not trials:
        return Round(scores=tuple(scores), trials=(), taken="")
    gained, pays = at.loglik - base.loglik, _pays(least)
    possible = [trial for trial in trials if inside(trial)]
    best = (possible or trials)[0]
    share = _share(criterion, base, at, floor, best)
    refusal: Refusal = ""
    if best.gain < settings.LEAST_GAIN:
        refusal = "chance"
    elif not possible:
        refusal = "outside its range"
    elif best.gain < min(settings.MINOR_SHARE, least) * gained:
        refusal = "minor"
    elif not floor.material(at.loglik) and best.gain < settings.MINOR_SHARE_AT_NOISE * gained:
        refusal = "minor beside noise"
    elif floor.material(at.loglik) and share < least and not _pays_off(criterion, at, best, pays):
        refusal = "small share"
    else:
        trials = [best, *(trial for trial in trials if trial is not best)]
    return Round(
        scores=tuple(scores),
        trials=tuple(trials),
        taken="" if refusal else best.cause,
        best=best,
        share=share,
        refusal=refusal,
    )


def _share(criterion: Criterion, base: Fit, at: Fit, floor: Floor, best: Trial) -> float:
    """Share of what is missing that the best explains, in the part of the data in which it gains most.

    What is missing in the other parts says nothing against it.  Where this one hardly lacks more than noise, it is all
    of it, unless it is a minor effect beside what was found there.
    """
    none, before, after = by_part(criterion, base.theta, at.theta, best.fit.theta)
    gains = after - before
    place = int(np.argmax(gains))
    lacking = floor.lacking(before, len(criterion.evidence.statics))[place]
    if np.isfinite(lacking):
        return float(gains[place] / lacking)
    if gains[place] > settings.MINOR_SHARE_AT_NOISE * (before - none)[place]:
        return 1.0
    excess = floor.excess(at.loglik)
    return best.gain / excess if excess > 0.0 else 1.0


def _pays_off(criterion: Criterion, at: Fit, best: Trial, pays: float) -> bool:
    return best.cause not in HOLDS and removed(criterion, at.theta, best.fit.theta) >= pays


def _pays(least: float) -> float:
    """Prediction benefit that replaces the required share; 1 (never) where more than LEAST_SHARE is required."""
    return settings.LEAST_BENEFIT if least <= settings.LEAST_SHARE else 1.0


def _with_dead_time(criterion: Criterion, at: Fit, scores: list[Score]) -> list[Score]:
    """Raise the scores of delays to the gain at the delay that the step responses show, where that is larger."""
    asked = [score for score in scores if "delays" in BY_NAME[score.cause].traits and score.testable]
    found = criterion.late if asked else None
    if found is None:
        return scores
    delay_s, T_A = found
    better = {}
    for score in asked:
        theta = probed(at.theta.having("T_A", T_A), BY_NAME[score.cause], delay_s)
        gain = criterion.value(theta) - at.loglik
        if gain > score.gain:
            better[score.cause] = replace(
                score, probe=delay_s, gain=gain, step=1.0, z=math.sqrt(2.0 * gain), beside=(), others=(("T_A", T_A),)
            )
    return sorted((better.get(score.cause, score) for score in scores), key=lambda found: -found.gain)


def _with_line(criterion: Criterion, at: Fit, scores: list[Score]) -> list[Score]:
    """Add the score of the strongest spectral line."""
    if any(name == periodic.AMPLITUDE for name, _ in at.theta.causes):
        return scores
    line = periodic.find_line(criterion, at.theta)
    if line is None:
        return scores
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
        phases_s=line.phases_s,
    )
    return sorted([*scores, score], key=lambda found: -found.gain)
