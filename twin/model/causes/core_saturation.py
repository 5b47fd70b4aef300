"""core-saturation: the iron saturates: the force grows less than with i^2.

i -> i / sqrt(1 + (i / i_s)^2)
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import SCALE

I_S = 11

CAUSE = Cause(
    name="core-saturation",
    family="force",
    title="the iron saturates: the force grows less than with i^2",
    sentence="the iron saturates: at {i_s_a} it pulls half as hard as i^2 says",
    acts_on="magnetic force (3)",
    equation="i -> i / sqrt(1 + (i / i_s)^2)",
    source="from about 1.5 T on iron takes up less and less field",
    parameters=(
        CauseParameter(
            name="i_s_a", symbol="i_s", unit="A", place=I_S, neutral=math.inf, low=0.2, high=100.0, probes=(6.0, 3.0)
        ),
    ),
    signature="low positions need more current than (3) says; large pulls upwards are weaker than small ones promise",
    shows_in=("holds", "lift-off", "prbs-open-loop"),
    confirm="note i_c at six heights: the line bends up where the gap is large",
    cure="less current (a lighter ball, a smaller gap), or a table of the force in place of (3)",
    told_from={
        "force-exponent": SCALE,
        "air-gap-offset": SCALE,
    },
    at_rest="balance",
)


@kernel
def field(c: Vector, i: float) -> float:
    """The current that the force sees, A."""
    if math.isinf(c[I_S]):
        return i
    share = i / c[I_S]
    return i / math.sqrt(1.0 + share * share)
