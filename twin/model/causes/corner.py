"""The corner of an output stage: nothing below a threshold, and a straight line above it."""

from __future__ import annotations

import math

from twin.compiled import kernel


@kernel
def behind_corner(value: float, threshold: float, rounding: float) -> float:
    """What is above the threshold, not negative; both in one unit.

    Args:
        value: what goes in.
        threshold: positive.
        rounding: over how much of the threshold the corner is rounded; 0: sharp.  Without input there is no output.
    """
    if rounding == 0.0 or value <= 0.0:
        return max(value - threshold, 0.0)
    corner = rounding * threshold
    at_zero = math.sqrt(threshold * threshold + corner * corner) - threshold
    return 0.5 * (value - threshold + math.sqrt((value - threshold) ** 2 + corner * corner) - at_zero)
