"""current-limit: the amplifier gives no more than a certain current.

i_c <= i_limit
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

LIMIT = 2

CAUSE = Cause(
    name="current-limit",
    family="amplifier",
    title="the amplifier gives no more than a certain current",
    acts_on="target current of (1)",
    equation="i_c <= i_limit",
    source="a power supply smaller than the rig's",
    parameters=(
        CauseParameter(
            name="limit_a",
            symbol="i_limit",
            unit="A",
            place=LIMIT,
            neutral=math.inf,
            low=0.02,
            high=20.0,
            probes=(2.0, 1.5, 1.2, 1.05, 0.9),
        ),
    ),
    signature="i_c stays flat at one value while u_c still rises",
    shows_in=("lift-off", "amplifier-steps"),
    confirm="turn u_c up slowly with the ball held and watch i_c stop",
    cure="a larger supply, or u_max on the board set below the limit",
    needs=("u_c", "i_c"),
)


@kernel
def limited(c: Vector, i: float) -> float:
    """The current that the supply allows, A."""
    return min(i, c[LIMIT])
