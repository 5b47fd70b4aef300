"""current-sensor-offset: i_c reads too high by a constant, or by an amount that wanders."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.wander import wander, wandering

OFFSET, WANDER = 24, 47

CAUSE = Cause(
    name="current-sensor-offset",
    family="sensing",
    title="i_c reads too high by a constant",
    sentence="i_c reads {offset_a} too high",
    opposite="i_c reads {offset_a} too low",
    acts_on="current sensor",
    equation="i_measured = i_c + offset",
    source="an amplifier of the shunt that was not zeroed; that of an INTECO rig drifts by tens of mA",
    parameters=(
        CauseParameter(name="offset_a", symbol="offset", unit="A", index=OFFSET, low=-0.3, high=0.3, probes=(0.01,)),
        wander(WANDER, unit="A", high=0.1, probe=0.02),
    ),
    signature="i_c is not 0 with the coil off, and the coil does not pull then",
    shows_in=("rest", "holds"),
    confirm="read i_c with the coil unplugged",
    cure="zero the sensor with the coil off, before each run",
    at_rest="balance",
    usual="constant",
    forms=(wandering("A", 0.02),),
)


@inlined
def shifted(c: Vector, reading: float) -> float:
    """The reading with its offset, A."""
    return reading + c[OFFSET]
