"""The maximum of a likelihood by Fisher scoring with Levenberg damping, and what is known there.

A coordinate at its bound that wants further out is left there.  A step solves (F + damping D) step = score with D the
diagonal of F (Levenberg 1944; Marquardt 1963), in coordinates scaled by the root of that diagonal: parameters differ by
ten orders of magnitude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.estimation.record import FloatArray
from twin.estimation.structures import NOISES

P = TypeVar("P")  # a point: all numbers of a model
NEAR = 0.3  # standard errors, where a wrong model makes the climb slow: what is left to gain is 0.05 of log-likelihood
CLOSE = 3.0  # standard errors from the maximum: nearer than that only exact slopes say where it is
_LITTLE = 0.05  # of log-likelihood
_NUDGE = 1e-3  # of a coordinate: tells whether it is at its bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Slopes:
    """Of a log-likelihood, by its free coordinates."""

    score: FloatArray  # shape (count,)
    fisher: FloatArray  # information, shape (count, count)
    exact: bool = True
    fresh: bool = True  # from this very point
    retained: Any = None  # whatever `Surface` wants to see again


class Surface(Protocol[P]):
    """A log-likelihood over the points of a model."""

    def moved(self, point: P, name: str, by: float) -> P:
        """One coordinate moved, within its bounds."""

    def most(self, name: str) -> float:
        """The largest move of a coordinate in one pass."""

    def visit(self, point: P) -> tuple[float, Any]:
        """(log-likelihood there, what `slopes` and `exact` want to know of the visit)."""

    def slopes(self, point: P, seen: Any, free: Sequence[str], before: Slopes | None, decrement: float) -> Slopes:
        """Slopes that are good enough to go on.

        Args:
            point: where.
            seen: of `visit`.
            free: the coordinates.
            before: those of the point before; None at the start.
            decrement: of the step that led here, standard errors; inf at the start.
        """

    def exact(self, point: P, seen: Any, free: Sequence[str]) -> Slopes:
        """Slopes of this very point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Summit(Generic[P]):
    """A maximum and what is known about it."""

    point: P
    loglik: float
    covariance: FloatArray  # of the free coordinates; 0 where one is at its bound
    converged: bool
    passes: int
    decrement: float  # of the last step, standard errors
    ahead: float  # log-likelihood that the slope here still promises, were it a parabola


def climb(surface: Surface[P], start: P, free: Sequence[str], *, passes: int, done: float, patience: int) -> Summit[P]:
    """Climb to the maximum from `start`.

    Args:
        surface: what is climbed.
        start: where from.
        free: coordinates that move; the others stay.
        passes: at most.
        done: decrement, in standard errors, from which on nothing that matters moves.
        patience: passes in a row that gain little, after which NEAR will do.
    """
    point, damping, converged = start, Damping(), False
    loglik, seen = surface.visit(start)
    slopes = surface.slopes(start, seen, free, None, math.inf)
    most = np.array([surface.most(name) for name in free])
    # One factor for the physics: the direction stays.  A noise level near its floor has no slope and asks for any step:
    # it is cut by itself, or it would hold back all the others.
    physics = np.array([name not in NOISES for name in free], np.bool_)
    decrement, used, slow = math.inf, 0, 0
    for _ in range(passes):
        used += 1
        step, decrement = newton(slopes, active_of(surface, point, free, slopes.score), damping.value)
        if decrement < CLOSE and not slopes.exact:
            slopes = surface.exact(point, seen, free)
            step, decrement = newton(slopes, active_of(surface, point, free, slopes.score), damping.value)
        if decrement < done or (slow >= patience and decrement < NEAR):
            converged = True
            break
        shorter = min([1.0, *(most / np.maximum(np.abs(step), 1e-300))[physics]])
        step = np.where(physics, step * shorter, np.clip(step, -most, most))
        trial = point
        for place, name in enumerate(free):
            trial = surface.moved(trial, name, float(step[place]))
        value, beyond = surface.visit(trial)
        if math.isfinite(value) and value > loglik - 1e-9 * abs(loglik):
            slow = slow + 1 if value - loglik < _LITTLE else 0
            damping.taken()
            point, loglik, seen = trial, value, beyond
            slopes = surface.slopes(point, seen, free, slopes, decrement)
        elif not (slopes.fresh and slopes.exact):
            slopes = surface.exact(point, seen, free)
        elif not damping.refused():
            break
    active = active_of(surface, point, free, slopes.score)
    _, left = newton(slopes, active, damping.value)
    return Summit(
        point=point,
        loglik=loglik,
        covariance=covariance_of(slopes.fisher, active),
        converged=converged or decrement < NEAR,
        passes=used,
        decrement=decrement,
        ahead=0.5 * left * left,
    )


def active_of(surface: Surface[P], point: P, free: Sequence[str], score: FloatArray) -> NDArray[np.bool_]:
    """Which coordinates may move: not one at its bound whose score points outwards."""
    return np.array(
        [
            surface.moved(point, name, _NUDGE if score[place] > 0.0 else -_NUDGE) != point
            for place, name in enumerate(free)
        ],
        np.bool_,
    )


def newton(slopes: Slopes, active: NDArray[np.bool_], damping: float) -> tuple[FloatArray, float]:
    """(step, Newton decrement in standard errors) of the coordinates that may move.

    Args:
        slopes: of the log-likelihood.
        active: which coordinates may move, shape (count,); the step of the others is 0.
        damping: Levenberg's, relative to the diagonal.

    Returns:
        The step, shape (count,), and the decrement, which is undamped: a step that damping has made small is no sign of
        a maximum.  Zeros and inf where the numbers are not finite.
    """
    score, fisher = slopes.score, slopes.fisher
    step = np.zeros(len(score))
    if not active.any():
        return step, 0.0
    g, F = score[active], fisher[np.ix_(active, active)]
    if not (np.isfinite(g).all() and np.isfinite(F).all()):
        return step, math.inf
    scale = np.sqrt(np.maximum(np.diag(F), 1e-12))
    scaled = F / np.outer(scale, scale)
    step[active] = np.linalg.lstsq(scaled + damping * np.eye(len(g)), g / scale, rcond=1e-14)[0] / scale
    whole = np.linalg.lstsq(scaled, g / scale, rcond=1e-14)[0] / scale
    return step, float(np.sqrt(max(float(whole @ g), 0.0)))


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of an information matrix, shape (count, count), scaled for rounding; inf where it is not finite."""
    if not np.isfinite(matrix).all():
        return np.full(matrix.shape, np.inf)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-13) / np.outer(scale, scale))


def covariance_of(fisher: FloatArray, active: NDArray[np.bool_]) -> FloatArray:
    """Inverse information of the coordinates that may move, shape (count, count); 0 for the others."""
    covariance = np.zeros_like(fisher)
    if active.any():
        covariance[np.ix_(active, active)] = inverse(fisher[np.ix_(active, active)])
    return covariance


class Damping:
    """Levenberg's damping: less after each step that was taken, more after each that was not."""

    def __init__(self) -> None:
        self.value = 1e-3

    def taken(self) -> None:
        """The step was taken."""
        self.value = max(self.value * 0.1, 1e-9)

    def refused(self) -> bool:
        """The step was not taken; whether another is worth a try."""
        self.value = max(self.value, 1e-4) * 10.0
        return self.value <= 1e8
