"""eddy-current-lag: the force follows the current late.

tau f' + f = i_c, F_m = K_c f^2 / gap^2
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import OSCILLOSCOPE

TAU = 13

CAUSE = Cause(
    name="eddy-current-lag",
    family="force",
    title="the force follows the current late",
    sentence="the force follows the current {tau_s} late",
    acts_on="magnetic force (3)",
    equation="tau f' + f = i_c, F_m = K_c f^2 / gap^2",
    source="eddy currents in a solid core hold the field back",
    parameters=(
        CauseParameter(
            name="tau_s", symbol="tau", unit="s", place=TAU, neutral=0.0, low=0.0, high=0.02, probes=(0.0002, 0.002)
        ),
    ),
    signature="the acceleration lags the measured current, the more the faster the current changes",
    shows_in=("prbs-reference", "prbs-open-loop"),
    confirm="put a search coil on the core and compare its integrated voltage with i_c",
    cure="a laminated core, or a lead of that time in the law",
    told_from={
        "actuation-delay": OSCILLOSCOPE,
    },
    traits=frozenset({"hidden-state"}),
)


@kernel
def lagged(c: Vector, f: float, i: float, i_next: float, h: float) -> float:
    """The field current after h s while the current goes from i to i_next, A."""
    if c[TAU] <= 0.0:
        return i_next
    slope = (i_next - i) / h
    return i_next - slope * c[TAU] + (f - i + slope * c[TAU]) * math.exp(-h / c[TAU])
