"""position-sensor-nonlinearity: x is right at the stops and wrong between them.

    x_measured = x + bow (1 - w^2) (1 + fullness w^2) (1 - skew^2 + 2.6 skew w),   w = 2 x / l - 1

l is the travel.  Skew 0 is an arc, skew 1 an S that is right in the middle.
"""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

BOW, SKEW, FULLNESS = 21, 29, 30
S_SHAPE = 1.5 * 3.0**0.5  # so that an S is off by the bow at most, too

CAUSE = Cause(
    name="position-sensor-nonlinearity",
    family="sensing",
    title="x is right at the stops and wrong between them",
    sentence="x reads up to {bow_m} too high between the stops and right at both",
    opposite="x reads up to {bow_m} too low between the stops and right at both",
    acts_on="position sensor",
    equation="x_measured = x + bow (1 - w^2) (1 + fullness w^2) (1 - skew^2 + 2.6 skew w), w = 2 x / l - 1",
    source="inductive sensors are bent, and are calibrated at two points",
    parameters=(
        CauseParameter(name="bow_m", symbol="bow", unit="m", index=BOW, low=-0.001, high=0.001, probes=(5e-05,)),
        CauseParameter(name="skew", symbol="skew", index=SKEW, low=-1.0, high=1.0, probes=(0.3,), spread=0.7),
        CauseParameter(
            name="fullness", symbol="fullness", index=FULLNESS, low=-1.0, high=1.0, probes=(0.3,), spread=0.5
        ),
    ),
    signature="the current that holds the ball and the free fall disagree with (6) in the middle, not at the ends",
    shows_in=("holds", "wide-steps", "prbs-open-loop"),
    confirm="read x over a staircase of shims of known thickness",
    cure="a table for the sensor on the board",
    at_rest="balance",
    usual="parabola",
    forms=(
        Form(name="cubic", values={"skew": 1.0}, source="E. O. Doebelin, Measurement Systems, 2003: an S", probed=True),
    ),
)


@inlined
def bent(c: Vector, x: float, travel: float) -> float:
    """The reading of a sensor that is calibrated at both stops, m."""
    if c[BOW] == 0.0:
        return x
    w = 2.0 * x / travel - 1.0
    side = 1.0 - c[SKEW] * c[SKEW] + S_SHAPE * c[SKEW] * w
    return x + c[BOW] * (1.0 - w * w) * (1.0 + c[FULLNESS] * w * w) * side


@inlined
def slope(c: Vector, x: float, travel: float) -> float:
    """Return the derivative of `bent` by x."""
    # By hand: a difference would take two readings in each of Newton's four steps.
    w = 2.0 * x / travel - 1.0
    side = 1.0 - c[SKEW] * c[SKEW] + S_SHAPE * c[SKEW] * w
    arc = (1.0 - w * w) * (1.0 + c[FULLNESS] * w * w)
    slope_w = 2.0 * w * (c[FULLNESS] - 1.0 - 2.0 * c[FULLNESS] * w * w)
    return 1.0 + 2.0 * c[BOW] / travel * (slope_w * side + arc * S_SHAPE * c[SKEW])
