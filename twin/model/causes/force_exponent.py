"""force-exponent: the force falls with another power of the gap than 2.

    d ln F_m / d ln gap = -(n + q (r - 1) + p (r - 1)^2),   r = gap / gap_mid

In the middle of the travel F_m = K_c i_c^2 / gap^2, and the power is n.  q = p = 0 is a pure power, q = n, p = 0 an
exponential.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector
from twin.model.causes.instruments import SCALE, SHIM

N, BEND, CURL = 10, 35, 45

CAUSE = Cause(
    name="force-exponent",
    family="force",
    title="the force falls with another power of the gap than 2",
    sentence="the force falls with the gap to the power of {n} in the middle, not of 2",
    opposite="the force falls with the gap to the power of {n} in the middle, not of 2",
    acts_on="magnetic force (3)",
    equation="d ln F_m / d ln gap = -(n + q (r - 1) + p (r - 1)^2), r = gap / gap_mid; (3) holds at r = 1",
    source="(3) holds for a thin gap between flat poles, and a ball below a round core is different",
    parameters=(
        CauseParameter(name="n", symbol="n", index=N, neutral=2.0, low=0.0, high=8.0, probes=(2.05,)),
        CauseParameter(name="bend", symbol="q", index=BEND, low=-8.0, high=8.0, probes=(0.1,), spread=2.0),
        CauseParameter(name="curl", symbol="p", index=CURL, low=-8.0, high=8.0, probes=(0.2,), spread=2.0),
    ),
    signature="the current that holds the ball is curved in x, where (3) has a straight line",
    shows_in=("holds", "slow-ramp", "wide-steps"),
    confirm="hold the ball at six heights and plot log i_c over log gap: the power is twice the slope",
    cure="the measured power in the model, and gains scheduled with x where steps are wide",
    deciding_measurements={
        "position-sensor-offset": SHIM,
        "position-sensor-gain": SHIM,
        "position-sensor-nonlinearity": SHIM,
        "constant-force": SCALE,
    },
    at_rest="balance",
    usual="power of the gap",
    forms=(
        Form(
            name="exponential of the gap",
            values={"bend": "n"},
            source="INTECO, Magnetic Levitation System user's manual: exp(-gap / l), so that q = n = gap_mid / l",
        ),
        Form(
            name="pole farther away",
            values={"bend": 1.0},
            source="W. Barie, J. Chiasson, International Journal of Systems Science 27(11), 1996: 1 / (a + gap)^2",
            probed=True,
        ),
    ),
)


@inlined
def factor(c: Vector, gap: float, gap_mid: float) -> float:
    """Return the factor on the force of (3); 1 in the middle of the travel."""
    n, q, p = c[N], c[BEND], c[CURL]
    if n == 2.0 and q == 0.0 and p == 0.0:
        return 1.0
    r = gap / gap_mid
    # The slope over ln gap, integrated from the middle of the travel on.
    return math.exp((2.0 - n + q - p) * math.log(r) + (2.0 * p - q) * (r - 1.0) - 0.5 * p * (r * r - 1.0))
