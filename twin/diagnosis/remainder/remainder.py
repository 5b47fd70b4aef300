"""The remainder: curves through what is left, a cause that has their form, and what they are worth.

Rule 1: a curve is fitted to the recordings for fitting.  The error of x 20 ms ahead on the first half of each judge
        recording chooses the curve; the second half measures its worth.
Rule 2: a curve is taken only if that error surely falls by more than 5 %, so that noise gets none.
Rule 3: a cause of the catalogue with the curve's form takes its place if it predicts as well.  It has fewer numbers and
        holds outside the range.  It stays a candidate: the search did not find enough for a name.
Rule 4: where a curve has taken the place of names by the likelihood (`rivals.py`), it is the only one that is tried.
        If it predicts as well, the names are left out of the extended model.  With `--quick` nothing else is modelled.
Rule 5: no other verdict and no confidence follows from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from twin.diagnosis.judge.flexible import flexible_errors
from twin.diagnosis.judge.prediction_gain import bootstrap, predictions, removed_share
from twin.diagnosis.remainder.curve_fits import (
    CurveScore,
    band,
    coefficients,
    fully_fitted,
    quantity_of,
    roughly_fitted,
    scores,
    visited,
    with_range,
)
from twin.diagnosis.remainder.rivals import Rival
from twin.diagnosis.search.candidate_fits import Trial, fit_candidates, refine, within_range
from twin.diagnosis.search.score_test import screen
from twin.distributions import Z_95
from twin.estimation.pace import pace_of
from twin.estimation.prediction_floor import floor_rmse
from twin.estimation.record import BoolArray, FloatArray
from twin.evidence.gather import Evidence
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.inference.theta import Theta
from twin.model.causes.cause import Cause
from twin.model.causes.curve import CURVES
from twin.settings import diagnosis as settings

POINTS = 41  # of a curve that is drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """A curve, over the range that was visited: about its mean there, with the ends of its 95 % band."""

    curve: Cause
    at: FloatArray  # in the unit of what it is a function of, shape (POINTS,)
    share: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Substitute:
    """A cause of the form of a curve, fitted in its place."""

    trial: Trial
    absorbed: float  # share of the information about it that the curve takes up


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """A curve, or a cause in its place, beside what was there: error 20 ms ahead where the choice was made."""

    name: str
    extends: Literal["causes", "paper"]
    loglik_gain: float
    rmse_m: float
    absorbed: float = math.nan  # of a cause: share of the information about it that the curve takes up


@dataclass(frozen=True, slots=True, kw_only=True)
class Improvement:
    """Errors of x on the judge samples that chose nothing."""

    horizon_s: float
    causes_rmse_m: float  # of the model with its causes alone
    extended_rmse_m: float  # with the remainder
    ci95_ratio: tuple[float, float]  # of these two
    floor_m: float
    flexible_rmse_m: float  # of a regression without physics; NaN where there is none
    count: int

    @property
    def removed(self) -> float:
        """Return the share of the squared error above the floor that the remainder removes; NaN if there was none."""
        return removed_share(self.causes_rmse_m, self.extended_rmse_m, self.floor_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Remainder:
    """The model of what is left: curves, or causes in their place; neither if nothing predicts better."""

    fit: Fit  # of the extended model
    extends: Literal["causes", "paper"]  # what it extends: the model with its causes, or the paper's
    shapes: tuple[Shape, ...]
    proposed: tuple[str, ...]  # causes that took the place of a curve
    replaced: tuple[Shape, ...]  # those curves
    attempts: tuple[Attempt, ...]
    refused: Cause | None  # the curve of a rival that predicts worse than the names
    improvement: Improvement


class CurveJudge:
    """Errors of x 20 ms ahead: the first half of each recording chooses, the second measures.

    Args:
        criterion: of the recordings for fitting.
        judge: recordings that no fit saw.
        seed: of the bootstrap.
    """

    def __init__(self, criterion: Criterion, judge: Evidence, seed: int) -> None:
        self.criterion, self.judge, self.seed = criterion, judge, seed
        self.samples = max(round(settings.BENEFIT_HORIZON_S / criterion.tick_s), 1)
        self.block = max(round(settings.ERROR_BLOCK_S / criterion.tick_s), 1)
        recording = judge.series.recording
        self.chooses: BoolArray = np.zeros(len(recording), np.bool_)
        for number in np.unique(recording):
            (rows,) = np.nonzero(recording == number)
            # Halves in time, not every other sample: errors 20 ms ahead overlap, so neighbours would share theirs.
            self.chooses[rows[: len(rows) // 2]] = True

    def squares(self, theta: Theta) -> FloatArray:
        """Return the square errors, shape (n,), m^2; NaN without a prediction.  Raises `Spent`."""
        plant, tick_s = self.criterion.plant, self.criterion.tick_s
        pace = pace_of(self.judge.series)
        self.criterion.budget.take(pace.steps_ahead(theta.base(plant), theta.vector(), self.samples))
        x_hat = predictions(self.judge, theta, plant, tick_s, self.samples)
        return np.asarray((x_hat - self.judge.series.x) ** 2)

    def choosing(self, squares: FloatArray) -> float:
        """Return the root mean square of the half that chooses; inf where it predicts nothing."""
        known = squares[self.chooses & np.isfinite(squares)]
        return math.sqrt(float(known.mean())) if len(known) else math.inf

    def ratio(self, before: FloatArray, after: FloatArray, where: BoolArray) -> tuple[float, float]:
        """Return the 95 % interval of the ratio of root mean squares."""
        both = where & np.isfinite(before) & np.isfinite(after)
        if both.sum() < settings.ERROR_BLOCKS * self.block:
            return math.nan, math.nan
        return bootstrap(before[both], after[both], self.block, self.seed)

    def improvement(self, before: FloatArray, after: FloatArray, theta: Theta, floor: Floor) -> Improvement:
        """Return the errors of the half that measures."""
        plant, tick_s = self.criterion.plant, self.criterion.tick_s
        # The other half picked the smallest of several errors, so its own error is too small.
        where = ~self.chooses & np.isfinite(before) & np.isfinite(after)
        flexible = flexible_errors(self.criterion.evidence, self.judge, self.samples, self.seed) ** 2
        known = where & np.isfinite(flexible)
        quiet = floor.quiet(theta).system(plant, tick_s)
        return Improvement(
            horizon_s=self.samples * tick_s,
            causes_rmse_m=math.sqrt(float(before[where].mean())),
            extended_rmse_m=math.sqrt(float(after[where].mean())),
            ci95_ratio=self.ratio(before, after, ~self.chooses),
            floor_m=floor_rmse(quiet, self.judge.samples, self.samples, where),
            flexible_rmse_m=math.sqrt(float(flexible[known].mean())) if known.any() else math.nan,
            count=int(where.sum()),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Extension:
    """A model with curves, or causes of their form, beside what it began with."""

    extends: Literal["causes", "paper"]
    fit: Fit
    squares: FloatArray  # errors of the judges
    curves: tuple[Cause, ...] = ()
    proposed: tuple[str, ...] = ()
    replaced: tuple[tuple[Cause, Fit], ...] = ()


def remainder_of(
    judging: CurveJudge,
    named: Fit,
    floor: Floor,
    candidates: Sequence[Cause],
    *,
    rival: Rival | None,
) -> Remainder | None:
    """Model what `named` leaves; None if the judges have too little flight to choose.

    Args:
        judging: chooses the curve, and measures its worth.
        named: the model with its causes.
        floor: sensor noise.
        candidates: causes that may have the form of a curve.
        rival: a curve that took the place of a name, and its fit; None: there is none.

    Raises:
        Spent: the budget does not pay for it.
    """
    before = judging.squares(named.theta)
    # The ratio of a model to itself is NaN only if there are too few blocks, for any other model as well.
    if math.isnan(judging.ratio(before, before, judging.chooses)[0]):
        return None
    attempts: list[Attempt] = []
    best = _Extension(extends="causes", fit=named, squares=before)
    refused: Cause | None = None
    if rival is None:
        best = _extend(judging, best, candidates, attempts)
    else:
        # No other curve: the names that it would stand beside no longer hold.
        instead = _substituted(judging, rival, named, attempts)
        if judging.choosing(instead.squares) <= settings.LIKE_ERROR * judging.choosing(before):
            best = instead
        else:
            refused = rival.curve
    values = visited(judging.criterion.evidence)
    return Remainder(
        fit=best.fit,
        extends=best.extends,
        shapes=tuple(_shape(best.fit, curve, values) for curve in best.curves),
        proposed=best.proposed,
        replaced=tuple(_shape(fit, curve, values) for curve, fit in best.replaced),
        attempts=tuple(attempts),
        refused=refused,
        improvement=judging.improvement(before, best.squares, best.fit.theta, floor),
    )


def _substituted(judging: CurveJudge, rival: Rival, named: Fit, attempts: list[Attempt]) -> _Extension:
    """Return the model with a curve in the place of a name."""
    squares = judging.squares(rival.fit.theta)
    extends: Literal["causes", "paper"] = "paper" if rival.is_sole else "causes"
    gain, error = rival.fit.loglik - named.loglik, judging.choosing(squares)
    attempts.append(Attempt(name=rival.curve.name, extends=extends, loglik_gain=gain, rmse_m=error))
    return _Extension(extends=extends, fit=rival.fit, squares=squares, curves=(rival.curve,))


def _extend(judging: CurveJudge, at: _Extension, candidates: Sequence[Cause], attempts: list[Attempt]) -> _Extension:
    """Add curves, or causes of their form, while the error falls.

    Args:
        judging: where the error falls.
        at: the model to begin with.
        candidates: causes that may have the form of a curve.
        attempts: receives each curve and each cause that was fitted.
    """
    criterion = judging.criterion
    for _ in range(settings.MAX_CURVES):
        promising = scores(criterion, at.fit, [curve for curve in CURVES if curve not in at.curves])
        promising = [score for score in promising[: settings.CURVES_FITTED] if score.evidence > settings.MIN_GAIN]
        # The likelihood chooses which curves are fitted, the prediction which one is kept: what a smooth function
        # gains one sample ahead says little about 20 ms.
        best = _best(judging, at, promising, attempts)
        # The upper end of the interval must be below the limit, so that noise gets no curve.
        if best is None or not judging.ratio(at.squares, best[2], judging.chooses)[1] < settings.CURVE_RATIO:
            break
        curve, fit, errors = best
        remaining = [cause for cause in candidates if cause.name not in at.proposed]
        alternatives = substitutes(criterion, at.fit, curve, fit.loglik - at.fit.loglik, remaining) if remaining else []
        substitute = _best_substitute(judging, at, errors, alternatives, attempts)
        if substitute is None:
            at = replace(at, fit=fit, squares=errors, curves=(*at.curves, curve))
        else:
            at = replace(
                at,
                fit=substitute[1],
                squares=substitute[2],
                proposed=(*at.proposed, substitute[0]),
                replaced=(*at.replaced, (curve, fit)),
            )
    return at


def _best(
    judging: CurveJudge, at: _Extension, promising: Sequence[CurveScore], attempts: list[Attempt]
) -> tuple[Cause, Fit, FloatArray] | None:
    """The curve that predicts best, fitted to the end; adds all to `attempts`."""
    criterion = judging.criterion
    fits = criterion.each(partial(roughly_fitted, criterion, at.fit), promising)
    results = [(entry.curve, fit, judging.squares(fit.theta)) for entry, fit in zip(promising, fits, strict=True)]
    if results:
        # Only the best is fitted to the end: its error tells it from the others long before its maximum is known.
        best_index = min(range(len(results)), key=lambda n: judging.choosing(results[n][2]))
        fit = fully_fitted(criterion, results[best_index][1])
        results[best_index] = results[best_index][0], fit, judging.squares(fit.theta)
    attempts += [
        Attempt(
            name=curve.name,
            extends=at.extends,
            loglik_gain=fit.loglik - at.fit.loglik,
            rmse_m=judging.choosing(errors),
        )
        for curve, fit, errors in results
    ]
    return min(results, key=lambda entry: judging.choosing(entry[2]), default=None)


def _best_substitute(
    judging: CurveJudge, at: _Extension, curve: FloatArray, alternatives: Sequence[Substitute], attempts: list[Attempt]
) -> tuple[str, Fit, FloatArray] | None:
    """The cause that predicts as well as the curve; None where none does.  Adds all to `attempts`."""
    results = [(entry, judging.squares(entry.trial.fit.theta)) for entry in alternatives]
    attempts += [
        Attempt(
            name=entry.trial.cause,
            extends=at.extends,
            loglik_gain=entry.trial.gain,
            rmse_m=judging.choosing(errors),
            absorbed=entry.absorbed,
        )
        for entry, errors in results
    ]
    best = min(results, key=lambda entry: judging.choosing(entry[1]), default=None)
    # A cause may be a little worse than the curve: it has fewer numbers, and holds outside the range.
    if best is None or judging.choosing(best[1]) > settings.LIKE_ERROR * judging.choosing(curve):
        return None
    return best[0].trial.cause, best[0].trial.fit, best[1]


def substitutes(
    criterion: Criterion, at: Fit, curve: Cause, gain: float, candidates: Sequence[Cause]
) -> list[Substitute]:
    """Return the causes whose form the curve has, fitted beside the other causes; those that gain most first.

    A curve has a cause's form if it takes up nearly all that the recordings could show of the cause.  With the curve
    free, the information about the cause is then gone.

    Args:
        criterion: of the recordings for fitting.
        at: the model without the curve.
        curve: which.
        gain: of log-likelihood, with the curve.
        candidates: testable causes.
    """
    thinned = criterion.thinner
    without_curve = {score.cause: score for score in screen(thinned, at.theta, at.free, candidates) if score.testable}
    theta = with_range(at.theta, curve, visited(criterion.evidence))
    with_curve = {score.cause: score for score in screen(thinned, theta, (*at.free, *coefficients(curve)), candidates)}
    # By the information, not by the two forms: what differs only outside the visited range is the same to the data.
    absorbed = {
        name: 1.0 - with_curve[name].visible / score.visible
        for name, score in without_curve.items()
        if name in with_curve and score.gain > max(settings.MIN_GAIN, settings.LIKE_GAIN * gain)
    }
    selected = [without_curve[name] for name, share in absorbed.items() if share >= settings.LIKE_SHARE]
    trials = fit_candidates(criterion, at, selected[: settings.MAX_SUBSTITUTES]) if selected else []
    trials = [refine(criterion, trial) for trial in trials]
    return [
        Substitute(trial=trial, absorbed=absorbed[trial.cause])
        for trial in trials
        if within_range(trial) and trial.gain > 0.0
    ]


def _shape(fit: Fit, curve: Cause, values: dict[str, FloatArray]) -> Shape:
    low, high = (fit.theta.value(f"{curve.name}.{parameter.name}") for parameter in curve.parameters[:2])
    at = np.linspace(low, high, POINTS)
    over = values[quantity_of(curve)]
    share, error = band(fit, curve, at, over[np.isfinite(over)])
    return Shape(curve=curve, at=at, share=share, low=share - Z_95 * error, high=share + Z_95 * error)
