"""force-exponent: the force falls with another power of the gap than 2.

F_m = K_c i_c^2 gap_mid^(n-2) / gap^n
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import SCALE, SHIM

N = 10

CAUSE = Cause(
    name="force-exponent",
    family="force",
    title="the force falls with another power of the gap than 2",
    sentence="the force falls with the gap to the power of {n}, not of 2",
    opposite="the force falls with the gap to the power of {n}, not of 2",
    acts_on="magnetic force (3)",
    equation="F_m = K_c i_c^2 gap_mid^(n-2) / gap^n",
    source="(3) is of a thin gap between flat poles; a ball below a round core is neither",
    parameters=(
        CauseParameter(name="n", symbol="n", unit="", place=N, neutral=2.0, low=1.0, high=4.0, probes=(2.05,)),
    ),
    signature="the current that holds the ball is curved in x, where (3) has a straight line",
    shows_in=("holds", "slow-ramp", "wide-steps"),
    confirm="hold the ball at six heights and plot log i_c over log gap: the power is twice the slope",
    cure="the measured power in the model, and gains scheduled with x where steps are wide",
    told_from={
        "position-sensor-offset": SHIM,
        "position-sensor-gain": SHIM,
        "position-sensor-nonlinearity": SHIM,
        "constant-force": SCALE,
    },
    at_rest="balance",
)


@kernel
def factor(c: Vector, gap: float, gap_mid: float) -> float:
    """Factor on the force of (3); 1 in the middle of the travel."""
    if c[N] == 2.0:
        return 1.0
    return math.exp((c[N] - 2.0) * math.log(gap_mid / gap))
