"""The stated values of a campaign that may be wrong: as good as a named cause, or taken up by the parameters.

    information of the final fit and of all suspects -> does the fit take a suspect up?
                                                     -> what is lost if a suspect replaces a cause?  -> fit it, compare

Nothing lists what equals what.  A suspect is equivalent where the information matrix has no more to say about it than
about the free parameters [Rothenberg 1971], (S 8); with a cause in exchange, where the likelihood stays within
EQUIVALENT_GAIN, (S 10).  The matrix costs one pass of a fit, and a fit follows only where the matrix promises a place
in a class.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnosis.search.candidate_fits import Trial, within_range
from twin.diagnosis.search.state import Selection
from twin.estimation.record import FloatArray
from twin.inference.fisher_scoring import Fit, climb, narrowing
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import inverse
from twin.inference.theta import Theta, coordinates_of, max_step, moved, parameter_of, unit_of
from twin.model.causes.cause import Cause
from twin.model.causes.stated import CLOCK, STATED
from twin.readers.host_clock import combined
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Absorbed:
    """A suspect that the free parameters take up: these data cannot show it."""

    cause: str
    by: tuple[str, ...]  # coordinates without which it would show; empty: none alone
    shows: bool  # whether it does something to these recordings


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedValues:
    """The suspects of a campaign."""

    classes: dict[str, tuple[Trial, ...]]  # by named cause, those that explain as much in its place
    absorbed: tuple[Absorbed, ...]
    slopes: tuple[FloatArray, FloatArray] | None = None  # (score, Fisher information) of the fit without suspects


@dataclass(frozen=True, slots=True, kw_only=True)
class _Information:
    """The Fisher information of a fit, with suspects beside its free coordinates."""

    names: tuple[str, ...]
    matrix: FloatArray  # shape (count, count)
    change: FloatArray  # derivatives of the outputs, shape (count, n, 5)

    def at(self, rows: Sequence[str], columns: Sequence[str]) -> FloatArray:
        index = {name: n for n, name in enumerate(self.names)}
        return self.matrix[np.ix_([index[name] for name in rows], [index[name] for name in columns])]

    def left(self, names: Sequence[str], others: Sequence[str]) -> FloatArray:
        """Return what the other coordinates cannot take up of the information on `names`, (S 8)."""
        cross = self.at(others, names)
        return self.at(names, names) - cross.T @ inverse(self.at(others, others)) @ cross

    def moves(self, name: str, others: Sequence[str]) -> dict[str, float]:
        """Return the moves of the other coordinates that go with one unit of `name` at the highest likelihood."""
        moves = -inverse(self.at(others, others)) @ self.at(others, [name])
        return dict(zip(others, moves[:, 0].tolist(), strict=True))


def examine(criterion: Criterion, selection: Selection, suspects: Sequence[Cause] = STATED) -> StatedValues:
    """Compare every suspect with the causes of a selection.

    Raises:
        Spent: the budget is too small.
    """
    fit = selection.fit
    strengths = {suspect.name: coordinates_of(suspect.name)[0] for suspect in suspects}
    names = (*fit.free, *strengths.values())
    base, change = criterion.derivatives(fit.theta, names)
    _, score, matrix = criterion.slopes(fit.theta, names, base, change)
    information = _Information(names=names, matrix=matrix, change=change)
    classes = {
        cause: tuple(
            trial
            for suspect in strengths
            if (trial := _in_place_of(criterion, selection, information, cause, suspect)) is not None
        )
        for cause in selection.causes
    }
    equal = {trial.cause for trials in classes.values() for trial in trials}
    absorbed = [
        _absorbed(information, fit.free, suspect, strength)
        for suspect, strength in strengths.items()
        if suspect not in equal
    ]
    count = len(fit.free)
    return StatedValues(
        classes=classes,
        absorbed=tuple(entry for entry in absorbed if entry is not None),
        slopes=(score[:count], matrix[:count, :count]),
    )


def with_members(selection: Selection, stated: StatedValues) -> Selection:
    """Return the selection with the suspects in the classes of its causes."""
    classes = {cause: (*selection.classes.get(cause, ()), *stated.classes.get(cause, ())) for cause in selection.causes}
    return replace(selection, classes={**selection.classes, **classes})


def _shows(total: float, left: float) -> bool:
    """Tell whether data show a suspect of usual size, by the rule for every candidate (`Score.testable`)."""
    return left > settings.VISIBLE * total and math.sqrt(max(left, 0.0)) >= settings.MIN_INFORMATION


def _absorbed(information: _Information, free: Sequence[str], suspect: str, strength: str) -> Absorbed | None:
    total, left = (float(information.left([strength], others)[0, 0]) for others in ((), free))
    if _shows(total, left):
        return None
    if not _shows(total, total):
        return Absorbed(cause=suspect, by=(), shows=False)
    # One number at a time: a number takes it up if the suspect would show without it.  Pairs are not asked, as their
    # count is quadratic.
    by = tuple(
        name
        for name in free
        if _shows(total, float(information.left([strength], [other for other in free if other != name])[0, 0]))
    )
    return Absorbed(cause=suspect, by=by, shows=True)


def _in_place_of(
    criterion: Criterion, selection: Selection, information: _Information, cause: str, suspect: str
) -> Trial | None:
    """Return the suspect's fit in place of a cause; None if it explains less."""
    fit = selection.fit
    gone, strength = coordinates_of(cause), coordinates_of(suspect)[0]
    others = [name for name in fit.free if name not in gone]
    total = float(information.at([strength], [strength])[0, 0])
    (own, cross), (_, left) = information.left([gone[0], strength], others)
    if not _shows(total, left):
        return None  # what is absorbed without the cause cannot explain what the cause explains
    parameter = parameter_of(gone[0])
    # (S 14): own, cross and left are M_cc, M_ce and M_ee, and the step is -c.
    # The strength goes to neutral, and the suspect to where the parabola is highest then.
    step = -parameter.coordinate(fit.theta.value(gone[0])) / unit_of(parameter)
    gain, loss, size = 0.5 * step**2 * own, 0.5 * step**2 * (own - cross**2 / left), -cross / left * step
    # A parabola is only near the likelihood, hence a share beside the threshold of the class.
    if not loss < max(settings.EQUIVALENT_GAIN, (1.0 - settings.SIMILAR_SCORE) * gain):
        return None
    theta = _exchanged(criterion, fit.theta, information, others, (cause, step), (suspect, size))
    free = (*others, strength)
    replaced = _corrected(criterion, information, theta, free)
    # An equivalent suspect is there by now.  A fit only decides about those that are near.
    if settings.EQUIVALENT_GAIN <= fit.loglik - replaced.loglik < settings.OUT_OF_CLASS_GAIN:
        replaced = climb(criterion, theta, free, passes=settings.PASSES_QUICK, tolerance=settings.CURVE_TOLERANCE)
    loss = fit.loglik - replaced.loglik + _contradiction(criterion, replaced, strength)
    trial = Trial(cause=suspect, fit=replaced, gain=selection.gains.get(cause, 0.0) - loss)
    return trial if loss < settings.EQUIVALENT_GAIN and within_range(trial) else None


def _corrected(criterion: Criterion, information: _Information, start: Theta, free: tuple[str, ...]) -> Fit:
    """Take Newton steps with the derivatives of the fit that was left, a run of the filter each."""
    # Derivatives of the fit that was left: new ones would cost a run for each free number in each step.
    change = information.change[[information.names.index(name) for name in free]]
    covariance = inverse(information.at(free, free))
    theta, best, loglik = start, start, -math.inf
    for _ in range(settings.STATED_STEPS):
        value, score, fisher = criterion.slopes(theta, free, criterion.outputs(theta), change)
        if not value > loglik:
            break
        best, loglik = theta, value
        for name, move in zip(free, inverse(fisher) @ score, strict=True):
            theta = moved(theta, name, min(max(float(move), -max_step(name)), max_step(name)), criterion.plant)
    loglik += narrowing(free, covariance)
    return Fit(theta=best, loglik=loglik, free=free, covariance=covariance, converged=False)


def _contradiction(criterion: Criterion, fit: Fit, strength: str) -> float:
    """Return the log-likelihood by which measurements beside the samples contradict a suspect.

    The computer's clock measures that of the board where the recordings have the times of arrival.
    """
    clock = combined([record.clock_error for record in criterion.evidence.records])
    if strength != coordinates_of(CLOCK)[0] or clock is None:
        return 0.0
    # A measurement beside the samples: z standard errors cost z^2 / 2, as under a Gaussian error.  A fixed limit would
    # forget how sure the clock is.
    spread = math.hypot(clock[1], fit.std(strength, criterion.plant))
    return 0.5 * ((fit.theta.value(strength) - clock[0]) / spread) ** 2


def _exchanged(
    criterion: Criterion,
    theta: Theta,
    information: _Information,
    others: Sequence[str],
    out: tuple[str, float],
    into: tuple[str, float],
) -> Theta:
    """Exchange a cause for a suspect, (name, move of its strength) each; the other coordinates follow."""
    # The other coordinates move with both, along the ridge of the likelihood.  Held, they would make the exchange look
    # worse than it is.
    follow = dict.fromkeys(others, 0.0)
    for name, step in (out, into):
        for other, move in information.moves(coordinates_of(name)[0], others).items():
            follow[other] += step * move
    theta = theta.without(out[0], criterion.plant)
    for name, move in follow.items():
        theta = moved(theta, name, min(max(move, -max_step(name)), max_step(name)), criterion.plant)
    return moved(theta, coordinates_of(into[0])[0], into[1], criterion.plant)
