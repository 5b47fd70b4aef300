"""amplifier-dead-zone: the amplifier does nothing below a certain input."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.corner import ROUNDED, behind_corner, rounding
from twin.model.causes.instruments import CLAMP_METER

WIDTH, ROUNDING = 4, 33

CAUSE = Cause(
    name="amplifier-dead-zone",
    family="amplifier",
    title="the amplifier does nothing below a certain input",
    sentence="the amplifier does nothing below an input of {width_v}",
    acts_on="input of (1)",
    equation="K_A max(u_c - u_0, 0), its corner rounded over r u_0",
    source="threshold of the output stage; the duty table of an INTECO rig shows one of 5 %",
    parameters=(
        CauseParameter(name="width_v", symbol="u_0", unit="V", index=WIDTH, low=0.0, high=2.0, probes=(0.05, 0.2)),
        rounding(ROUNDING),
    ),
    signature="i_c is 0 up to some u_c and a straight line from there, which misses the origin",
    shows_in=("amplifier-steps", "lift-off"),
    confirm="ramp u_c up slowly from 0 and note where i_c begins",
    cure="add the width to every u_c above 0 on the board",
    needs=("u_c", "i_c"),
    deciding_measurements={"current-sensor-offset": CLAMP_METER},
    at_rest="amplifier",
    added_a=lambda width_v, K_A: -K_A * width_v,
    usual="sharp corner",
    forms=(ROUNDED,),
)


@inlined
def effective_input(c: Vector, u: float) -> float:
    """The input behind the dead zone, V."""
    return behind_corner(u, c[WIDTH], c[ROUNDING])
