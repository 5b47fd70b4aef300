"""current-sensor-gain: i_c reads in the wrong scale."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector

GAIN = 25

CAUSE = Cause(
    name="current-sensor-gain",
    family="sensing",
    title="i_c reads in the wrong scale",
    sentence="i_c reads {gain:%} too large",
    opposite="i_c reads {gain:%} too small",
    acts_on="current sensor",
    equation="i_measured = gain i_c",
    source="tolerance of the shunt",
    parameters=(
        CauseParameter(name="gain", symbol="gain", index=GAIN, neutral=1.0, low=0.5, high=1.5, probes=(0.98,)),
    ),
    signature="none: K_A and K_c absorb it exactly",
    shows_in=(),
    confirm="put a clamp meter beside the sensor at a large constant current",
    cure="calibrate the shunt",
    not_testable="absorbed by K_A and K_c: a reading gain times too high gives K_A gain times and K_c 1/gain^2 times "
    "the true one, and the same motion",
)


@inlined
def scaled(c: Vector, i: float) -> float:
    """The reading in the sensor's scale, A."""
    return c[GAIN] * i
