"""The parabola that a sensor's input follows within a substep."""

from __future__ import annotations

from twin.compiled import inlined


@inlined
def through(begin: float, middle: float, end: float, h: float) -> tuple[float, float]:
    """Return (slope at the beginning, second derivative) of the parabola through the values at 0, h / 2 and h, in s."""
    return (4.0 * middle - 3.0 * begin - end) / h, 4.0 * (begin - 2.0 * middle + end) / (h * h)
