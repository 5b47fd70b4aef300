"""position-sensor-nonlinearity: x is right at the stops and wrong between them.

x_measured = x + 4 bow x/l (1 - x/l), l the travel
"""

from __future__ import annotations

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

BOW = 21

CAUSE = Cause(
    name="position-sensor-nonlinearity",
    family="sensing",
    title="x is right at the stops and wrong between them",
    sentence="x reads {bow_m} too high in the middle of the travel and right at both stops",
    opposite="x reads {bow_m} too low in the middle of the travel and right at both stops",
    acts_on="position sensor",
    equation="x_measured = x + 4 bow x/l (1 - x/l), l the travel",
    source="inductive sensors are bent, and are calibrated at two points",
    parameters=(
        CauseParameter(
            name="bow_m", symbol="bow", unit="m", place=BOW, neutral=0.0, low=-0.001, high=0.001, probes=(5e-05,)
        ),
    ),
    signature="the current that holds the ball and the free fall disagree with (6) in the middle, not at the ends",
    shows_in=("holds", "wide-steps", "prbs-open-loop"),
    confirm="read x over a staircase of shims of known thickness",
    cure="a table for the sensor on the board",
)


@kernel
def bent(c: Vector, x: float, travel: float) -> float:
    """The reading of a sensor that is calibrated at both stops, m."""
    place = x / travel
    return x + 4.0 * c[BOW] * place * (1.0 - place)
