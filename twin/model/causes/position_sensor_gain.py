"""position-sensor-gain: x reads in the wrong scale."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import SHIM

GAIN = 20

CAUSE = Cause(
    name="position-sensor-gain",
    family="sensing",
    title="x reads in the wrong scale",
    sentence="x reads {gain:%} too large",
    opposite="x reads {gain:%} too small",
    acts_on="position sensor",
    equation="x_measured = gain x",
    source="published slopes of the CE 152's sensor differ by 9 %: 800 to 870 V/m",
    parameters=(
        CauseParameter(name="gain", symbol="gain", index=GAIN, neutral=1.0, low=0.5, high=1.5, probes=(0.99,)),
    ),
    signature="x is 0 on the rest but not the travel at the top stop; forces look wrong in proportion to x",
    shows_in=("prbs-open-loop", "lift-off"),
    confirm="read x with a shim of known thickness under the ball, and at the top stop",
    cure="calibrate the sensor at both stops",
    deciding_measurements={"position-sensor-nonlinearity": SHIM},
    at_rest="balance",
)


@inlined
def scaled(c: Vector, reading: float) -> float:
    """The reading in the sensor's scale, m."""
    return c[GAIN] * reading
