"""The corner of an output stage: nothing below a threshold, and a straight line above it."""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import CauseParameter, Form

ROUNDED = Form(
    name="rounded corner",
    values={"rounding": 0.4},
    source="P. R. Gray, R. G. Meyer, Analysis and Design of Analog Integrated Circuits: class B stages",
)


def rounding(index: int) -> CauseParameter:
    """The shape of a corner: over how much of the threshold it is rounded."""
    return CauseParameter(name="rounding", symbol="r", index=index, low=0.0, high=1.5, probes=(0.1,), spread=0.5)


@inlined
def behind_corner(value: float, threshold: float, share: float) -> float:
    """Return the part of a value above the threshold, never negative; both in one unit.

    Args:
        value: what goes in.
        threshold: positive.
        share: over how much of the threshold the corner is rounded; 0: sharp.  Without input there is no output.
    """
    if share == 0.0 or value <= 0.0:
        return max(value - threshold, 0.0)
    corner = share * threshold
    # Taken off so that no input gives no output: a hyperbola alone would leave a current.
    at_zero = math.sqrt(threshold * threshold + corner * corner) - threshold
    return 0.5 * (value - threshold + math.sqrt((value - threshold) ** 2 + corner * corner) - at_zero)
