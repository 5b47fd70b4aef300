"""Small estimates without a library: a line through points with its interval, the error of a clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, linear_regression

T_95 = 2.2  # Student's t, 97.5 %, for about ten degrees of freedom


@dataclass(frozen=True, slots=True)
class Line:
    """A line y = offset + slope x by least squares, with half the 95 % interval of the slope."""

    offset: float
    slope: float
    slope_interval: float
    residuals: tuple[float, ...]

    def at(self, x: float) -> float:
        """Return y at x."""
        return self.offset + self.slope * x


def line_through(x: Sequence[float], y: Sequence[float]) -> Line:
    """Fit a line to three points or more, of which two differ in x."""
    slope, offset = linear_regression(x, y)
    x_mean = fmean(x)
    s_xx = sum((a - x_mean) ** 2 for a in x)
    residuals = tuple(b - offset - slope * a for a, b in zip(x, y, strict=True))
    variance = sum(r * r for r in residuals) / max(len(x) - 2, 1)
    return Line(offset, slope, T_95 * math.sqrt(variance / s_xx), residuals)


def clock_error(ticks: Sequence[int], arrivals_s: Sequence[float], tick_s: float) -> tuple[float, float]:
    """Return how much faster than the host's the board's clock is, in ppm, and half its 95 % interval.

    A frame can be late, never early, so the earliest arrival of each tenth of the time counts.
    """
    delays = [arrival - tick * tick_s for tick, arrival in zip(ticks, arrivals_s, strict=True)]
    size = len(ticks) // 10
    best = [min(range(n * size, (n + 1) * size), key=delays.__getitem__) for n in range(10)]
    fitted = line_through([ticks[n] * tick_s for n in best], [arrivals_s[n] for n in best])
    return (1.0 / fitted.slope - 1.0) * 1e6, fitted.slope_interval * 1e6
