"""The search for the cause of the catalogue that would make a given curve.  It is proposed, with a test.

A curve has a cause's form if it takes up nearly all that the recordings could show of the cause.  With the curve free,
the information about the cause is then gone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.diagnosis.remainder.curve_fits import coefficients, visited, with_range
from twin.diagnosis.search.candidate_fits import Trial, fit_candidates, refine, within_range
from twin.diagnosis.search.score_test import screen
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings

MAX_SUBSTITUTES = 2  # causes that are fitted


@dataclass(frozen=True, slots=True, kw_only=True)
class Substitute:
    """A cause of the form of a curve, fitted in its place."""

    trial: Trial
    absorbed: float  # share of the information about it that the curve takes up


def substitutes(
    criterion: Criterion, at: Fit, curve: Cause, gain: float, candidates: Sequence[Cause]
) -> list[Substitute]:
    """Return the causes whose form the curve has, fitted beside the other causes; those that gain most first.

    Args:
        criterion: of the recordings for fitting.
        at: the model without the curve.
        curve: which.
        gain: of log-likelihood, with the curve.
        candidates: testable causes.
    """
    thinned = criterion.thinner
    without_curve = {score.cause: score for score in screen(thinned, at.theta, at.free, candidates) if score.testable}
    over = curve.parameters[0].name.removeprefix("from_")
    theta = with_range(at.theta, curve, visited(criterion.evidence)[over])
    with_curve = {score.cause: score for score in screen(thinned, theta, (*at.free, *coefficients(curve)), candidates)}
    # By the information, not by the two forms: what differs only outside the visited range is the same to the data.
    absorbed = {
        name: 1.0 - with_curve[name].visible / score.visible
        for name, score in without_curve.items()
        if name in with_curve and score.gain > max(settings.MIN_GAIN, settings.LIKE_GAIN * gain)
    }
    selected = [without_curve[name] for name, share in absorbed.items() if share >= settings.LIKE_SHARE][
        :MAX_SUBSTITUTES
    ]
    trials = [refine(criterion, trial) for trial in fit_candidates(criterion, at, selected)] if selected else []
    return [
        Substitute(trial=trial, absorbed=absorbed[trial.cause])
        for trial in trials
        if within_range(trial) and trial.gain > 0.0
    ]
