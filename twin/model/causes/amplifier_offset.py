"""amplifier-offset: the amplifier adds a constant current.

K_A u_c + i_offset, not below 0: one below 0 has a corner there, sharp or rounded
"""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.corner import ROUNDED, behind_corner, rounding
from twin.model.causes.instruments import CLAMP_METER, UNPLUGGED

OFFSET, ROUNDING = 5, 42

CAUSE = Cause(
    name="amplifier-offset",
    family="amplifier",
    title="the amplifier adds a constant current",
    sentence="the amplifier gives {offset_a} more than K_A u_c",
    opposite="the amplifier gives {offset_a} less than K_A u_c",
    acts_on="target current of (1)",
    equation="K_A u_c + i_offset, not below 0",
    source="offset of the output stage; an INTECO rig gives 0.043 A at zero input",
    parameters=(
        CauseParameter(name="offset_a", symbol="i_offset", unit="A", index=OFFSET, low=-0.3, high=0.3, probes=(0.01,)),
        rounding(ROUNDING),
    ),
    signature="i_c is not 0 at u_c = 0 (or begins late), and the coil does pull then",
    shows_in=("rest", "amplifier-steps"),
    confirm="measure the coil's current with a clamp meter at u_c = 0 and at one large u_c",
    cure="trim the amplifier, or take the offset off u_c on the board",
    needs=("u_c", "i_c"),
    deciding_measurements={"current-sensor-offset": CLAMP_METER, "constant-force": UNPLUGGED},
    at_rest="amplifier",
    added_a=lambda offset_a, K_A: offset_a,
    usual="sharp corner",
    forms=(ROUNDED,),
)


@inlined
def shifted(c: Vector, target: float) -> float:
    """Return the target current with the offset, A, not negative."""
    offset = c[OFFSET]
    return behind_corner(target, -offset, c[ROUNDING]) if offset < 0.0 else max(target + offset, 0.0)
