"""position-sensor-nonlinearity: x is right at the stops and wrong between them.

x_measured = x + 4 bow s (1 - s) (1 + skew w + fullness w^2), s = x/l, w = 2 s - 1, l the travel: any polynomial of
fourth degree that is right at both stops.
"""

from __future__ import annotations

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

BOW = 21
SKEW = 29
FULLNESS = 30

CAUSE = Cause(
    name="position-sensor-nonlinearity",
    family="sensing",
    title="x is right at the stops and wrong between them",
    sentence="x reads {bow_m} too high in the middle of the travel and right at both stops",
    opposite="x reads {bow_m} too low in the middle of the travel and right at both stops",
    acts_on="position sensor",
    equation="x_measured = x + 4 bow s (1 - s) (1 + skew w + fullness w^2), s = x/l, w = 2 s - 1, l the travel",
    source="inductive sensors are bent, and are calibrated at two points",
    parameters=(
        CauseParameter(
            name="bow_m", symbol="bow", unit="m", place=BOW, neutral=0.0, low=-0.001, high=0.001, probes=(5e-05,)
        ),
        CauseParameter(name="skew", symbol="skew", unit="", place=SKEW, neutral=0.0, low=-0.5, high=0.5, probes=(0.3,)),
        CauseParameter(
            name="fullness", symbol="fullness", unit="", place=FULLNESS, neutral=0.0, low=-0.5, high=0.5, probes=(0.3,)
        ),
    ),
    signature="the current that holds the ball and the free fall disagree with (6) in the middle, not at the ends",
    shows_in=("holds", "wide-steps", "prbs-open-loop"),
    confirm="read x over a staircase of shims of known thickness",
    cure="a table for the sensor on the board",
    at_rest="balance",
)


@kernel
def bent(c: Vector, x: float, travel: float) -> float:
    """The reading of a sensor that is calibrated at both stops, m."""
    s = x / travel
    w = 2.0 * s - 1.0
    return x + 4.0 * c[BOW] * s * (1.0 - s) * (1.0 + c[SKEW] * w + c[FULLNESS] * w * w)


@kernel
def slope(c: Vector, x: float, travel: float) -> float:
    """Derivative of `bent` by x."""
    s = x / travel
    w = 2.0 * s - 1.0
    shape = 1.0 + c[SKEW] * w + c[FULLNESS] * w * w
    return 1.0 + 4.0 * c[BOW] / travel * (s * (1.0 - s) * (2.0 * c[SKEW] + 4.0 * c[FULLNESS] * w) - w * shape)
