"""Maximum likelihood by Fisher scoring with Levenberg damping.

A step solves (F + damping D) step = score with D the diagonal of F (Levenberg 1944; Marquardt 1963).  Coordinates are
scaled by the square root of that diagonal, as parameters differ by ten orders of magnitude.  A coordinate at its bound
whose score points outwards stays there.

Not Gauss-Newton or BFGS: the noise levels are parameters, so the weights of the residuals change.  The information
matrix costs nothing beyond the derivatives, and is positive semidefinite, unlike the Hessian.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.estimation.record import FloatArray
from twin.inference.theta import COLOURS, NOISES, Theta, max_step, moved
from twin.settings import diagnosis as settings

SLOW_TOLERANCE = 0.3  # decrement, standard errors, that suffices if convergence is slow: 0.05 of log-likelihood is left
CLOSE = 3.0  # decrement, standard errors, below which exact derivatives are used
_LITTLE = 0.05  # of log-likelihood: a pass that gains less counts as slow
_NUDGE = 1e-3  # of a coordinate: test whether it is at its bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Slopes:
    """Derivatives of a log-likelihood by its free coordinates."""

    score: FloatArray  # shape (count,)
    fisher: FloatArray  # information, shape (count, count)
    exact: bool = True
    fresh: bool = True  # computed at this point
    retained: Any = None  # data of the `Surface` for its next call


class Surface(Protocol):
    """A log-likelihood over the parameters of the model."""

    plant: Plant

    def visit(self, point: Theta) -> tuple[float, Any]:
        """Return (log-likelihood at the point, data for `slopes` and `exact`)."""

    def slopes(
        self, point: Theta, outputs: Any, free: Sequence[str], before: Slopes | None, decrement: float
    ) -> Slopes:
        """Return the derivatives, approximate if that suffices.

        Args:
            point: the point.
            outputs: data of `visit`.
            free: the coordinates.
            before: derivatives at the previous point; None at the start.
            decrement: of the step to this point, standard errors; inf at the start.
        """

    def exact(self, point: Theta, outputs: Any, free: Sequence[str]) -> Slopes:
        """Return the exact derivatives at this point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A maximum of the likelihood, its covariance and its convergence."""

    theta: Theta
    loglik: float  # with the shapes of its causes integrated out
    free: tuple[str, ...]
    covariance: FloatArray  # of the coordinates; 0 for one at its bound
    converged: bool
    ahead: float = 0.0  # log-likelihood that the slope here still promises, were it a parabola
    passes: int = 0
    decrement: float = math.inf  # of the last step, standard errors

    def std(self, name: str, plant: Plant) -> float:
        """Return the standard error in the unit of the parameter; inf if it was not free."""
        if name not in self.free:
            return math.inf
        index = self.free.index(name)
        spread = math.sqrt(max(float(self.covariance[index, index]), 0.0))
        value = self.theta.value(name)
        shifted = moved(self.theta, name, 1e-3, plant).value(name)
        # At an upper bound a step outwards moves nothing, so the unit comes from a step inwards.
        if shifted == value:
            shifted = moved(self.theta, name, -1e-3, plant).value(name)
        return spread * abs(shifted - value) / 1e-3


def climb(
    surface: Surface,
    start: Theta,
    free: Sequence[str],
    *,
    passes: int,
    tolerance: float,
    patience: int,
    goal: float = -math.inf,
) -> Fit:
    """Climb to the maximum from `start`.

    Args:
        surface: the log-likelihood.
        start: starting point.
        free: coordinates to estimate; the others stay.
        passes: largest number of passes.
        tolerance: decrement of convergence, standard errors; at most SLOW_TOLERANCE.
        patience: consecutive passes with little gain after which SLOW_TOLERANCE suffices; after twice as many it
            ends in any case, as slopes that promise more are those of a likelihood with kinks.
        goal: log-likelihood; where slope and last step promise less than a part of the way, nobody needs the maximum.
    """
    point, damping = start, Damping()
    loglik, outputs = surface.visit(start)
    slopes = surface.slopes(start, outputs, free, None, math.inf)
    decrement, used, slow = math.inf, 0, 0
    for _ in range(passes):
        used += 1
        slopes, step, decrement = _next_step(surface, point, outputs, free, slopes, damping.value)
        if decrement < tolerance or (slow >= patience and decrement < SLOW_TOLERANCE) or slow >= 2 * patience:
            break
        trial = shortened(surface.plant, point, free, step)
        value, trial_outputs = surface.visit(trial)
        # Equal values count as progress: along a flat direction rounding decides, and a rejection only adds damping.
        if math.isfinite(value) and value > loglik - 1e-9 * abs(loglik):
            gain = value - loglik
            slow = slow + 1 if gain < _LITTLE else 0
            point, loglik, outputs = trial, value, trial_outputs
            # Also by what the step gained: along a limit of the steps each gains more than its slope promised.
            if value + settings.GOAL_REACH * max(0.5 * decrement**2, gain) < goal:
                break
            damping.accepted()
            slopes = surface.slopes(point, outputs, free, slopes, decrement)
        # Before a step is blamed, its derivatives are: old or approximate ones may point the wrong way.
        elif not (slopes.fresh and slopes.exact):
            slopes = surface.exact(point, outputs, free)
        elif not damping.rejected():
            break
    active = active_of(surface.plant, point, free, slopes.score)
    _, left = newton(slopes, active, damping.value)
    return Fit(
        theta=point,
        loglik=loglik,
        free=tuple(free),
        covariance=covariance_of(slopes.fisher, active),
        converged=decrement < SLOW_TOLERANCE,
        passes=used,
        decrement=decrement,
        ahead=0.5 * left * left,
    )


def _next_step(
    surface: Surface, point: Theta, outputs: Any, free: Sequence[str], slopes: Slopes, damping: float
) -> tuple[Slopes, FloatArray, float]:
    """Return (the derivatives used, the step, its decrement)."""
    step, decrement = newton(slopes, active_of(surface.plant, point, free, slopes.score), damping)
    # Approximate derivatives find the way, but only exact ones may decide that the way has ended.
    if decrement < CLOSE and not slopes.exact:
        slopes = surface.exact(point, outputs, free)
        step, decrement = newton(slopes, active_of(surface.plant, point, free, slopes.score), damping)
    return slopes, step, decrement


def shortened(plant: Plant, point: Theta, free: Sequence[str], step: FloatArray) -> Theta:
    """The point after a step, shortened to the largest that is allowed."""
    # One factor shortens the step of all physical parameters, which keeps its direction.  The likelihood is flat in a
    # noise level near its floor, so its step can be arbitrarily large: noise levels are limited separately.
    limits = np.array([max_step(name) for name in free])
    physics = np.array([name not in NOISES + COLOURS for name in free], np.bool_)
    shorter = min([1.0, *(limits / np.maximum(np.abs(step), 1e-300))[physics]])
    for name, change in zip(free, np.where(physics, step * shorter, np.clip(step, -limits, limits)), strict=True):
        point = moved(point, name, float(change), plant)
    return point


def active_of(plant: Plant, point: Theta, free: Sequence[str], score: FloatArray) -> NDArray[np.bool_]:
    """Return which coordinates may move, shape (count,): all but those at a bound whose score points outwards."""
    return np.array(
        [
            # The point itself knows its bounds, so a small move is tried in place of a second list of bounds.
            moved(point, name, _NUDGE if score[index] > 0.0 else -_NUDGE, plant) != point
            for index, name in enumerate(free)
        ],
        np.bool_,
    )


def newton(slopes: Slopes, active: NDArray[np.bool_], damping: float) -> tuple[FloatArray, float]:
    """Return the damped Newton step and Newton decrement.

    Args:
        slopes: derivatives of the log-likelihood.
        active: which coordinates may move, shape (count,); the step of the others is 0.
        damping: Levenberg's, relative to the diagonal.

    Returns:
        The step, shape (count,), and the decrement, standard errors.  The decrement is undamped, as a damped step is
        also small far from a maximum.  Zeros and inf if a derivative is not finite.
    """
    score, fisher = slopes.score, slopes.fisher
    step = np.zeros(len(score))
    if not active.any():
        return step, 0.0
    g, F = score[active], fisher[np.ix_(active, active)]
    if not (np.isfinite(g).all() and np.isfinite(F).all()):
        return step, math.inf
    scale = np.sqrt(np.maximum(np.diag(F), 1e-12))
    # Least squares instead of Cholesky: a coordinate without information makes F singular, and its step should be 0.
    scaled = F / np.outer(scale, scale)
    step[active] = np.linalg.lstsq(scaled + damping * np.eye(len(g)), g / scale, rcond=1e-14)[0] / scale
    whole = np.linalg.lstsq(scaled, g / scale, rcond=1e-14)[0] / scale
    return step, float(np.sqrt(max(float(whole @ g), 0.0)))


def inverse(matrix: FloatArray) -> FloatArray:
    """Invert an information matrix, shape (count, count), scaled against rounding; inf if it is not finite."""
    if not np.isfinite(matrix).all():
        return np.full(matrix.shape, np.inf)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-13) / np.outer(scale, scale))


def covariance_of(fisher: FloatArray, active: NDArray[np.bool_]) -> FloatArray:
    """Return the inverse information of the active coordinates, shape (count, count); 0 for the others."""
    covariance = np.zeros_like(fisher)
    if active.any():
        covariance[np.ix_(active, active)] = inverse(fisher[np.ix_(active, active)])
    return covariance


class Damping:
    """Levenberg's damping: reduced after each accepted step, increased after each rejected one."""

    def __init__(self) -> None:
        self.value = 1e-3

    def accepted(self) -> None:
        """Reduce the damping after an accepted step."""
        self.value = max(self.value * 0.1, 1e-9)

    def rejected(self) -> bool:
        """Increase the damping after a rejected step; returns whether to try another step."""
        self.value = max(self.value, 1e-4) * 10.0
        return self.value <= 1e8
