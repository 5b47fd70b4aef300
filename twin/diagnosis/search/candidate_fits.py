"""Fit candidates by successive halving: all of them a little, the leading ones to the end.

Rule 1: a candidate that is far behind may only have a worse starting value.  It is dropped only if its slope, too,
        shows that it cannot catch up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from twin.diagnosis.search.candidate_starts import start_of
from twin.diagnosis.search.prediction_benefit import error_reduction
from twin.diagnosis.search.score_test import Score
from twin.inference.fisher_scoring import Fit, approach, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import coordinates_of, parameter_of, reinitialised
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.settings import diagnosis as settings

_SAME = {cause.name: cause.same_samples_as for cause in CATALOGUE if cause.same_samples_as}


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A candidate and its fit."""

    cause: str
    fit: Fit
    gain: float  # of log-likelihood, against the model without it, beyond what the search makes out of noise


def fit_candidates(
    criterion: Criterion,
    current: Fit,
    scores: Sequence[Score],
    min_gain: float = 0.0,
    min_reduction: float = 1.0,
    cutoff_gain: float = -math.inf,
) -> list[Trial]:
    """Fit the candidates, the leading ones to the end; best first.

    Args:
        criterion: of the recordings for fitting.
        current: the model without them.
        scores: the candidates.
        min_gain: gain below which no candidate will be selected, unless it improves the prediction.
        min_reduction: share of the mean square prediction error that it must remove in that case.
        cutoff_gain: gain below which a candidate is not fitted further.
    """
    names = [score.cause for score in scores]
    # Causes with the same effect on the samples share a fit.
    copies = {copy: original for copy, original in _SAME.items() if original in names and copy in names}
    scores = [score for score in scores if score.cause not in copies]
    trials = criterion.each(partial(start_trial, criterion, current), scores)
    # The candidates with the best scores pass the first stage in any case: a poor start costs a fit more than a score.
    favourites = {score.cause for score in scores[: settings.SAFE_CANDIDATES]}
    # Successive halving: fits to the end of all candidates would spend most passes on those that are far behind.
    # Dropping by the gain alone would lose a candidate with a poor start, so its slope counts, too.
    for stage, (passes, min_share, max_candidates) in enumerate(settings.HALVING):
        trials.sort(key=lambda trial: -_expected(trial))
        best = max((trial.gain for trial in trials), default=0.0)
        last = stage == len(settings.HALVING) - 1 and bool(trials)
        # The last stage compares with the end of the best fit.  Before that its lead is uncertain by STEEPNESS_DOUBT.
        overtaken = (1.0 - (0.0 if last else settings.STEEPNESS_DOUBT)) * best - settings.EQUIVALENT_GAIN
        # If no candidate can reach the required gain, the last passes are worth their cost only for a cause that
        # improves the prediction: half of the required reduction so far makes that likely.
        if last and all(_promise(trial) < min_gain for trial in trials):
            leader = max(trials, key=lambda trial: trial.gain)
            enough = 0.5 * min_reduction
            if enough >= 0.5 or error_reduction(criterion, current.theta, leader.fit.theta) < enough:
                break
        active: set[str] = set()
        for rank, trial in enumerate(trials):
            # Two estimates for two errors: the parabola ranks the candidates, and its multiple bounds what a likelihood
            # that is not a parabola may still give.
            goes_on = rank < max_candidates and _expected(trial) >= min_share * best and _promise(trial) >= overtaken
            goes_on = goes_on and _promise(trial) >= cutoff_gain
            if goes_on or (stage == 0 and trial.cause in favourites):
                active.add(trial.cause)
        trials = criterion.each(partial(_refine_active, criterion, active, passes, last), trials)
    else:
        trials = _finish_first(criterion, trials, active, cutoff_gain)
    trial_of = {trial.cause: trial for trial in trials}
    trials += [renamed(criterion, trial_of[original], copy) for copy, original in copies.items()]
    return sorted(trials, key=lambda trial: -trial.gain)


def _finish_first(criterion: Criterion, trials: list[Trial], ended: set[str], cutoff_gain: float) -> list[Trial]:
    """Fit the best trial within its range to the end, unless that was done or it cannot reach the cutoff.

    It may be selected, or be in the class.
    """
    trials = sorted(trials, key=lambda trial: -trial.gain)
    # The best within its range, not the best of all: a cause outside its range is refused whatever its fit gains.
    first = next((n for n, trial in enumerate(trials) if within_range(trial)), None)
    if first is not None:
        trial = trials[first]
        if trial.cause not in ended and not trial.fit.converged and _promise(trial) >= cutoff_gain:
            trials[first] = refine(criterion, trial)
    return trials


def start_trial(criterion: Criterion, current: Fit, score: Score) -> Trial:
    """Fit the candidate of a score a little."""
    start = start_of(criterion.thinner, current.theta, score)
    fit = approach(criterion, start, current.free + coordinates_of(score.cause))
    fit = _with_exchanged_lags(criterion, current, fit, score.cause)
    return Trial(cause=score.cause, fit=fit, gain=fit.loglik - current.loglik - score.chance)


def _with_exchanged_lags(criterion: Criterion, current: Fit, fit: Fit, cause: str) -> Fit:
    """Return the better of a fit and one in which T_A and the time of the cause have changed places.

    Two lags in series are the same to a sensor behind both, so each order is a maximum, and only one is the truth.
    """
    strength = BY_NAME[cause].strength
    name, T_A = f"{cause}.{strength.name}", fit.theta.T_A
    if strength.unit != "s" or not strength.low < T_A < strength.high:
        return fit
    start = fit.theta.having("T_A", fit.theta.value(name)).having(name, T_A)
    # The other numbers still fit the first order, so the exchange alone may be far worse than it.  Not worth a fit is
    # only what is worse than the model without the cause.
    if criterion.value(start) <= current.loglik:
        return fit
    again = approach(criterion, start, fit.free)
    return again if again.loglik > fit.loglik else fit


def _refine_active(criterion: Criterion, active: set[str], passes: int, last: bool, trial: Trial) -> Trial:
    if trial.cause not in active or trial.fit.converged:
        return trial
    return refine(criterion, trial, passes, approximate=not last)


def same_as(cause: str) -> set[str]:
    """The causes whose effect on the samples is identical."""
    return {copy if cause == original else original for copy, original in _SAME.items() if cause in (original, copy)}


def renamed(criterion: Criterion, trial: Trial, cause: str) -> Trial:
    """The same trial under the name of a cause with an identical effect on the samples.

    It is fitted again where it has a shape that this cause lacks, as the two are not identical then.
    """

    def name(old: str) -> str:
        return old.replace(f"{trial.cause}.", f"{cause}.", 1) if old.startswith(f"{trial.cause}.") else old

    fit, coordinates = trial.fit, coordinates_of(cause)
    lacking = [old for old in coordinates_of(trial.cause) if name(old) not in coordinates]
    indices = [k for k, old in enumerate(fit.free) if old not in lacking]
    causes = tuple((name(old), value) for old, value in fit.theta.causes if old not in lacking)
    same = replace(
        fit,
        theta=replace(fit.theta, causes=causes),
        free=tuple(name(fit.free[k]) for k in indices),
        covariance=fit.covariance[np.ix_(indices, indices)],
    )
    if any(fit.theta.value(old) != parameter_of(old).neutral for old in lacking):
        same = climb(criterion, reinitialised(same.theta), same.free)
    return Trial(cause=cause, fit=same, gain=trial.gain + same.loglik - fit.loglik)


def refine(criterion: Criterion, trial: Trial, passes: int = settings.PASSES, *, approximate: bool = False) -> Trial:
    """Fit a trial further; the arguments are those of `climb`."""
    fit = climb(criterion, trial.fit.theta, trial.fit.free, passes=passes, approximate=approximate)
    return replace(trial, fit=fit, gain=trial.gain + fit.loglik - trial.fit.loglik)


def _expected(trial: Trial) -> float:
    """Return the gain expected at the maximum if the likelihood is a parabola."""
    return trial.gain if trial.fit.converged else trial.gain + trial.fit.ahead


def _promise(trial: Trial) -> float:
    """Return the upper bound of the gain that a trial may still reach."""
    return trial.gain if trial.fit.converged else trial.gain + steepness(trial.cause) * trial.fit.ahead


def steepness(cause: str) -> float:
    """Return the factor by which the likelihood may rise above the parabola of its slope."""
    # The likelihood of a delay is flat at zero, so one factor for all causes would drop delays or keep everything.
    return settings.STEEPNESS_DELAY if BY_NAME[cause].family == "timing" else settings.STEEPNESS


def within_range(trial: Trial) -> bool:
    """Tell whether every parameter of the cause lies within its physical range and not at its end."""
    for name in coordinates_of(trial.cause):
        parameter = parameter_of(name)
        value = trial.fit.theta.value(name)
        # A limit at infinity acts on no sample.
        if math.isinf(value):
            return False
        span = parameter.high - parameter.low
        ends = [end for end in (parameter.low, parameter.high) if end != parameter.neutral]
        # A strength at its end is set by the catalogue and not by the data.  A shape may end there, as an end can be a
        # formula of its own.
        if any(abs(value - end) < 1e-6 * span for end in ends) and (
            parameter.walks or name == coordinates_of(trial.cause)[0]
        ):
            return False
    return True
