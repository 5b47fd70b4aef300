"""force-exponent: the force falls with another power of the gap than 2.

F_m = K_c i_c^2 gap_mid^(n-2) / gap^n
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

N = 10

CAUSE = Cause(
    name="force-exponent",
    family="force",
    title="the force falls with another power of the gap than 2",
    acts_on="magnetic force (3)",
    equation="F_m = K_c i_c^2 gap_mid^(n-2) / gap^n",
    source="iron paths of finite size give other powers than 2",
    parameters=(
        CauseParameter(name="n", symbol="n", unit="", place=N, neutral=2.0, low=1.0, high=4.0, probes=(2.05,)),
    ),
    signature="the current that holds the ball is curved in x",
    shows_in=("holds", "slow-ramp", "wide-steps"),
    confirm="note i_c at six heights; the square root law gives a straight line",
    cure="use the measured power in the model",
)


@kernel
def factor(c: Vector, gap: float, gap_mid: float) -> float:
    """Factor on the force of (3); 1 in the middle of the travel."""
    if c[N] == 2.0:
        return 1.0
    return math.exp((c[N] - 2.0) * math.log(gap_mid / gap))
