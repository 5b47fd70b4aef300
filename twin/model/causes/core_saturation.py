"""core-saturation: the iron saturates: the force grows less than with i^2.

    i -> i / (1 + a (i / i_s)^n)^(1/n),   a = 2^(n/2) - 1

At i_s the force is half of what i^2 says, for any n.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector
from twin.model.causes.instruments import SCALE

I_S, KNEE = 11, 31

CAUSE = Cause(
    name="core-saturation",
    family="force",
    title="the iron saturates: the force grows less than with i^2",
    sentence="the iron saturates: at {i_s_a} it pulls half as hard as i^2 predicts",
    acts_on="magnetic force (3)",
    equation="i -> i / (1 + a (i / i_s)^n)^(1/n), a = 2^(n/2) - 1",
    source="from about 1.5 T on iron takes up less and less field",
    parameters=(
        CauseParameter(
            name="i_s_a", symbol="i_s", unit="A", index=I_S, neutral=math.inf, low=0.2, high=100.0, probes=(6.0, 3.0)
        ),
        CauseParameter(name="knee", symbol="n", index=KNEE, neutral=2.0, low=0.7, high=8.0, probes=(2.3,), spread=1.0),
    ),
    signature="low positions need more current than (3) says; large pulls upwards are weaker than small ones suggest",
    shows_in=("holds", "lift-off", "prbs-open-loop"),
    confirm="note i_c at six heights: the line bends up where the gap is large",
    cure="less current (a lighter ball, a smaller gap), or a table of the force in place of (3)",
    deciding_measurements={"force-exponent": SCALE, "air-gap-offset": SCALE},
    at_rest="balance",
    usual="root of a sum of squares",
    forms=(
        Form(name="Froehlich", values={"knee": 1.0}, source="O. Froehlich, Elektrotechnische Zeitschrift 2, 1881"),
        Form(name="hyperbolic tangent", values={"knee": 2.5}, source="tanh, a usual fit of a magnetisation curve"),
        Form(name="sharp knee", values={"knee": 6.0}, source="two straight lines with a knee"),
    ),
)


@inlined
def field(c: Vector, i: float) -> float:
    """The current that the force sees, A."""
    if math.isinf(c[I_S]):
        return i
    share = i / c[I_S]
    # The usual form by a root: the general one takes three powers at each stage of a substep.
    if c[KNEE] == 2.0:
        return i / math.sqrt(1.0 + share * share)
    n = c[KNEE]
    # 2^(n/2) - 1 puts half of the force at i_s, whatever n is.
    return float(i / (1.0 + (2.0 ** (0.5 * n) - 1.0) * max(share, 0.0) ** n) ** (1.0 / n))
