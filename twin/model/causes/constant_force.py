"""constant-force: a constant force acts on the ball."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector

FORCE = 16

CAUSE = Cause(
    name="constant-force",
    family="motion",
    title="a constant force acts on the ball",
    sentence="a constant force of {force_n} pushes the ball up",
    opposite="a constant force of {force_n} pulls the ball down",
    acts_on="net force of (6)",
    equation="m x'' = ... + F_0",
    source="a wrong mass in [plant], a tilted rig, a draught",
    parameters=(
        CauseParameter(name="force_n", symbol="F_0", unit="N", index=FORCE, low=-0.05, high=0.05, probes=(0.001,)),
    ),
    signature="free fall is slower or faster than g, by the same at every height",
    shows_in=("prbs-open-loop", "holds"),
    confirm="weigh the ball; let it drop with the coil off and time it",
    cure="the right mass in [plant]; level the rig",
    at_rest="balance",
)


@inlined
def force_n(c: Vector) -> float:
    """The force upwards, N."""
    return c[FORCE]
