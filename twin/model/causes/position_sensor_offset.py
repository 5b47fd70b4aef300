"""position-sensor-offset: x reads too high by a constant, or by an amount that wanders."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import SHIM
from twin.model.causes.wander import wander, wandering

OFFSET, WANDER = 19, 48

CAUSE = Cause(
    name="position-sensor-offset",
    family="sensing",
    title="x reads too high by a constant",
    sentence="x reads {offset_m} too high",
    opposite="x reads {offset_m} too low",
    acts_on="position sensor",
    equation="x_measured = x + offset",
    source="a sensor that was zeroed with something in between, or that has moved since",
    parameters=(
        CauseParameter(
            name="offset_m", symbol="offset", unit="m", index=OFFSET, low=-0.002, high=0.002, probes=(0.0001,)
        ),
        wander(WANDER, unit="m", high=0.0002, probe=0.00005),
    ),
    signature="x is not 0 with the ball on its rest, and off by the same at the top stop",
    shows_in=("rest", "lift-off"),
    confirm="read x with the ball on its rest, the coil off",
    cure="zero the sensor with the ball on its rest",
    deciding_measurements={"constant-force": SHIM, "sensor-crosstalk": SHIM},
    traits=frozenset({"displaces"}),
    at_rest="balance",
    usual="constant",
    forms=(wandering("m", 0.00005),),
)


@inlined
def shifted(c: Vector, reading: float) -> float:
    """The reading with its offset, m."""
    return reading + c[OFFSET]
