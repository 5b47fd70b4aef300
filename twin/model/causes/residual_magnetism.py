"""residual-magnetism: the iron keeps a field that the current sensor does not see."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import CLAMP_METER, UNPLUGGED

I_R = 12

CAUSE = Cause(
    name="residual-magnetism",
    family="force",
    title="the iron keeps a field that the current sensor does not see",
    sentence="the iron keeps a field, as if the current were {i_r_a} larger than the sensor shows",
    opposite="the iron keeps a field against the coil's, as if the current were {i_r_a} smaller than the sensor shows",
    acts_on="magnetic force (3)",
    equation="i -> i_c + i_r",
    source="remanence of core and ball",
    parameters=(CauseParameter(name="i_r_a", symbol="i_r", unit="A", index=I_R, low=-0.3, high=0.3, probes=(0.01,)),),
    signature="the ball needs a constant current less (or more) than (3) says, at every height alike",
    shows_in=("holds", "lift-off"),
    confirm="hold a compass needle to the core with the coil off; demagnetise and measure again",
    cure="demagnetise the core, or add i_r to the current in the model and in the operating point",
    deciding_measurements={
        "current-sensor-offset": CLAMP_METER,
        "constant-force": UNPLUGGED,
        "amplifier-offset": UNPLUGGED,
    },
    at_rest="balance",
)


@inlined
def field(c: Vector, i: float) -> float:
    """The current that the force sees, A."""
    return max(i + c[I_R], 0.0)
