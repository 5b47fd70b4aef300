"""residual-magnetism: the iron keeps a field that the current sensor does not see.

i -> i_c + i_r
"""

from __future__ import annotations

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

I_R = 12

CAUSE = Cause(
    name="residual-magnetism",
    family="force",
    title="the iron keeps a field that the current sensor does not see",
    acts_on="magnetic force (3)",
    equation="i -> i_c + i_r",
    source="remanence of core and ball",
    parameters=(
        CauseParameter(
            name="i_r_a", symbol="i_r", unit="A", place=I_R, neutral=0.0, low=-0.3, high=0.3, probes=(0.01,)
        ),
    ),
    signature="the ball needs a constant current less than the law says, at every height",
    shows_in=("holds", "lift-off"),
    confirm="a compass needle at the core with the coil off",
    cure="demagnetise the core, or add i_r in the law",
)


@kernel
def field(c: Vector, i: float) -> float:
    """The current that the force sees, A."""
    return max(i + c[I_R], 0.0)
