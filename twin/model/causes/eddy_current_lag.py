"""eddy-current-lag: the force follows the current late.

    tau z' + z = (i_c / gap^p)^a,   F_m = K_c (z^(1/a) gap^p)^2 / gap^2

The current lags (p = 0, a = 1), the flux (p = 1, a = 1) or the force (p = 1, a = 2).  A share s may lag n times as
long as the rest; tau is then the mean.  Eddy currents of a solid core have many time constants, of which these are two.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector
from twin.model.causes.instruments import OSCILLOSCOPE

TAU, FLUX, ORDER, SLOW, TIMES = 13, 34, 37, 125, 126
MIN_GAP_SHARE = 0.02  # of the middle gap: nearer to the coil the weight stays

CAUSE = Cause(
    name="eddy-current-lag",
    family="force",
    title="the force follows the current late",
    sentence="the force follows the current {tau_s} late",
    acts_on="magnetic force (3)",
    equation="tau z' + z = (i_c / gap^p)^a, F_m = K_c z^(2/a) gap^(2p - 2); a share s lags n times as long",
    source="eddy currents in a solid core hold the field back",
    parameters=(
        CauseParameter(name="tau_s", symbol="tau", unit="s", index=TAU, low=0.0, high=0.02, probes=(0.0002, 0.002)),
        CauseParameter(name="flux", symbol="p", index=FLUX, low=0.0, high=1.5, probes=(0.3,), spread=0.7),
        CauseParameter(
            name="order", symbol="a", index=ORDER, neutral=1.0, low=0.5, high=2.5, probes=(1.3,), spread=0.7
        ),
        CauseParameter(name="slow", symbol="s", index=SLOW, low=0.0, high=0.9, probes=(0.2,), spread=0.3),
        CauseParameter(
            name="times", symbol="n", index=TIMES, neutral=10.0, low=2.0, high=50.0, probes=(10.0,), spread=20.0
        ),
    ),
    signature="the acceleration lags the measured current, the more the faster the current changes",
    shows_in=("prbs-reference", "prbs-open-loop"),
    confirm="put a search coil on the core and compare its integrated voltage with i_c",
    cure="a laminated core, or a lead of that time in the law",
    deciding_measurements={"actuation-delay": OSCILLOSCOPE},
    traits=frozenset({"hidden-state"}),
    usual="lag of the current",
    forms=(
        Form(
            name="lag of the flux",
            values={"flux": 1.0},
            source="R. L. Stoll, The Analysis of Eddy Currents, 1974: the flux through the core is held back",
            probed=True,
        ),
        Form(
            name="lag of the force",
            values={"flux": 1.0, "order": 2.0},
            source="the force follows its static value with one time constant, as servo models have it",
            probed=True,
        ),
        Form(
            name="two time constants",
            values={"slow": 0.3},
            source="R. L. Stoll, The Analysis of Eddy Currents, 1974: the field diffuses into a solid core",
            probed=True,
        ),
    ),
)


@inlined
def power(x: float, exponent: float) -> float:
    """Return x^exponent, x >= 0, without logarithms for the exponents that the forms begin with."""
    if exponent == 1.0:
        return x
    if exponent == 2.0:
        return x * x
    return math.sqrt(x) if exponent == 0.5 else x**exponent


@inlined
def weight(c: Vector, gap: float, gap_mid: float) -> float:
    """Return the quantity that lags, per current at this gap; 1 in the middle of the travel."""
    if c[FLUX] == 0.0 or c[TAU] <= 0.0:
        return 1.0
    # Limited near the coil: with an infinite weight the current behind it would be no number.
    return power(gap_mid / max(gap, MIN_GAP_SHARE * gap_mid), c[FLUX])


@inlined
def quick(c: Vector) -> float:
    """Return the shorter time constant, s."""
    # From the mean of both: tau = (1 - s) q + s n q.
    return c[TAU] if c[SLOW] == 0.0 else c[TAU] / (1.0 + c[SLOW] * (c[TIMES] - 1.0))


@inlined
def lagged(c: Vector, f: float, i: float, i_next: float, w: float, w_next: float, h: float) -> float:
    """The field current after h s while the current goes from i to i_next, and its weight from w to w_next, A."""
    if c[TAU] <= 0.0:
        return i_next
    before, begin, end, a, tau = f * w, i * w, i_next * w_next, c[ORDER], quick(c)
    # A negative current has no power that is not whole: it counts as none.
    if a != 1.0:
        before, begin, end = power(max(before, 0.0), a), power(max(begin, 0.0), a), power(max(end, 0.0), a)
    # Exact for a quantity that goes straight; held over the step, it would lag by half of it.
    slope = (end - begin) / h
    after = end - slope * tau + (before - begin + slope * tau) * math.exp(-h / tau)
    return (after if a == 1.0 else power(max(after, 0.0), 1.0 / a)) / w_next


@inlined
def mixed(c: Vector, f: float, slow: float) -> float:
    """The field current that the ball feels, A, of the two that lag."""
    return f if c[SLOW] == 0.0 or c[TAU] <= 0.0 else (1.0 - c[SLOW]) * f + c[SLOW] * slow


@inlined
def slow(c: Vector, z: float, i: float, i_next: float, h: float) -> float:
    """The slow field current after h s while the current goes from i to i_next, A."""
    if c[SLOW] == 0.0 or c[TAU] <= 0.0:
        return z
    tau, slope = quick(c) * c[TIMES], (i_next - i) / h
    return i_next - slope * tau + (z - i + slope * tau) * math.exp(-h / tau)
