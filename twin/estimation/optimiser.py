"""One step of Fisher scoring with Levenberg damping, and what is known at the maximum.

The step solves (F + damping D) step = score with D the diagonal of F (Levenberg 1944; Marquardt 1963), in coordinates
scaled by the root of that diagonal: parameters differ by ten orders of magnitude.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.estimation.record import FloatArray


def newton(
    score: FloatArray, fisher: FloatArray, active: NDArray[np.bool_], damping: float
) -> tuple[FloatArray, float]:
    """(step, Newton decrement in standard errors) of the coordinates that may move.

    Args:
        score: slope of the log-likelihood, shape (count,).
        fisher: information, shape (count, count).
        active: which coordinates may move, shape (count,); the step of the others is 0.
        damping: Levenberg's, relative to the diagonal.

    Returns:
        The step, shape (count,), and the decrement, which is undamped: a step that damping has made small is no sign of
        a maximum.  Zeros and inf where the numbers are not finite.
    """
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
