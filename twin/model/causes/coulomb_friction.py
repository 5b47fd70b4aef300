"""coulomb-friction: dry friction holds and brakes the ball.

F_f sign(x'), and up to F_f at rest
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

FORCE = 15
CREEP_M_S = 2e-4  # slower than this the ball counts as held

CAUSE = Cause(
    name="coulomb-friction",
    family="motion",
    title="dry friction holds and brakes the ball",
    sentence="dry friction of {force_n} holds and brakes the ball",
    acts_on="net force of (6)",
    equation="F_f sign(x'), and up to F_f at rest",
    source="a ball that touches its guide",
    parameters=(
        CauseParameter(
            name="force_n", symbol="F_f", unit="N", place=FORCE, neutral=0.0, low=0.0, high=0.05, probes=(0.0005, 0.004)
        ),
    ),
    signature="the ball sticks and slips under a slow reference; i_c at one height differs between rising and sinking",
    shows_in=("slow-ramp", "multisine"),
    confirm="move the reference slowly up and down and compare i_c at the same height",
    cure="free the ball from its guide, level the rig",
)


@kernel
def friction_n(c: Vector, v: float) -> float:
    """The force against the motion, N; steep through zero speed, so that a ball at rest is held."""
    if c[FORCE] == 0.0:
        return 0.0
    return c[FORCE] * math.tanh(v / CREEP_M_S)
