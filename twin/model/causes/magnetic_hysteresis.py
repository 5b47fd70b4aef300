"""magnetic-hysteresis: the field follows the current on a loop that does not depend on the rate.

    F_m sees i - i_h z,   -1 <= z <= 1
    back to z = 0:        |dz| = (1 + |z|)^m |di| / i_t
    on to the branch:     |z| = (1 - exp(-s^(1/n)))^n,  s = way of i since z = 0, in i_t

z tells on which branch of its loop the iron is: 1 after a long rise of the current, -1 after a long fall.
n = 1 and m = 0 is the loop of Bouc and Wen of order 1, n = m = 1 that of Dahl.  n = 0 with i_t = i_h would be a play:
the field waits until the current has come 2 i_h back.  The smallest n rounds its corners by 0.005 i_h.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector
from twin.model.causes.instruments import OSCILLOSCOPE

HALF_WIDTH, TURN, ORDER, BACK = 119, 120, 121, 122
_SMALL = 1e-8
# Of n.  A sharper corner makes the likelihood less smooth.  A play as a case of its own would have no slope by n, and
# the prior alone would move n in a fit.
_SHARPEST = 0.01
_ON_THE_BRANCH = 1.0 - 1e-9

CAUSE = Cause(
    name="magnetic-hysteresis",
    family="force",
    title="the iron holds its field back: a loop of force over current",
    sentence="the iron holds its field back by {i_h_a} of current on the way up and on the way down",
    acts_on="magnetic force (3)",
    equation="i -> i_c - i_h z; back to z = 0: |dz| = (1 + |z|)^m |di| / i_t, then |z| = (1 - exp(-s^(1/n)))^n",
    source="hysteresis of the core; Y.-K. Wen, Random Vibration of Hysteretic Systems, 1976, eq. (2): n = 1, m = 0",
    parameters=(
        CauseParameter(name="i_h_a", symbol="i_h", unit="A", index=HALF_WIDTH, low=0.0, high=0.3, probes=(0.005,)),
        CauseParameter(
            name="turn_a", symbol="i_t", unit="A", index=TURN, neutral=0.1, low=0.005, high=1.0, probes=(0.1,)
        ),
        CauseParameter(
            name="order", symbol="n", index=ORDER, neutral=1.0, low=_SHARPEST, high=2.0, probes=(0.7,), spread=0.5
        ),
        CauseParameter(name="back", symbol="m", index=BACK, low=0.0, high=1.0, probes=(0.3,), spread=0.5),
    ),
    signature="the same current at the same height carries less after a rise of the current than after a fall",
    shows_in=("steps", "prbs-reference", "lift-off"),
    confirm="move the ball up and down slowly between two heights: i_c over x is a loop that stays at half the speed",
    cure="soft or laminated iron, or the inverse of the loop before u_c",
    deciding_measurements={"eddy-current-lag": OSCILLOSCOPE},
    traits=frozenset({"hidden-state"}),
    usual="Bouc-Wen",
    forms=(
        Form(
            name="Dahl",
            values={"back": 1.0},
            source="P. R. Dahl, A Solid Friction Model, 1968, for the loop of dry friction",
        ),
        Form(
            name="play",
            values={"order": _SHARPEST},
            source="M. Krasnosel'skii, A. Pokrovskii, Systems with Hysteresis, 1989: play, with i_t = i_h",
            probed=True,
        ),
    ),
)


@inlined
def _since_zero(z: float, n: float) -> float:
    """Return the way of the current since z = 0, in i_t, of 0 <= z < 1."""
    rise = z ** (1.0 / n)
    # The first term of the series: 1 - rise has lost the digits of a small rise.
    return z if rise < _SMALL else (-math.log(1.0 - rise)) ** n


@inlined
def _after(s: float, n: float) -> float:
    """Return z after a way of the current since z = 0, in i_t."""
    power = s ** (1.0 / n)
    return s if power < _SMALL else (1.0 - math.exp(-power)) ** n


@inlined
def turned(c: Vector, z: float, f: float, f_next: float) -> float:
    """Return where on its loop the iron is after the field current went from f to f_next, A; z: where it was."""
    if c[HALF_WIDTH] <= 0.0 or f_next == f:
        return z
    branch = 1.0 if f_next > f else -1.0
    # Below 1: on the branch itself the way since z = 0 would be infinite.
    way, level = abs(f_next - f) / c[TURN], min(branch * z, _ON_THE_BRANCH)
    if level < 0.0:
        # d(1 - level) / d(way) = -(1 - level)^m, which is a power of a straight line, or an exponential.
        power, left = 1.0 - c[BACK], 1.0 - level
        straight = power > _SMALL
        back = (left**power - 1.0) / power if straight else math.log(left)
        if way <= back:
            left = (left**power - power * way) ** (1.0 / power) if straight else left * math.exp(-way)
            return branch * (1.0 - left)
        way, level = way - back, 0.0
    return branch * _after(_since_zero(level, c[ORDER]) + way, c[ORDER])


@inlined
def field(c: Vector, f: float, z: float) -> float:
    """Return the current that the force sees, A."""
    return f - c[HALF_WIDTH] * z
