"""second-time-constant: a share of the current comes with a time constant of its own.

    i_c = (1 - a) i_1 + a i_2,   T_A i_1' + i_1 = e,   tau i_2' + i_2 = e

e is the current that the amplifier tends to.  A second loop beside the coil's does so: a frame or a solid core in which
the field induces currents, or the filter of a power stage.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector
from twin.model.causes.instruments import OSCILLOSCOPE

SHARE, TAU = 123, 124

CAUSE = Cause(
    name="second-time-constant",
    family="amplifier",
    title="a share of the current comes with a second time constant",
    sentence="a share of the current, {share:%}, comes with a second time constant of {tau_s}",
    opposite="the current overshoots by {share:%} and returns with a second time constant of {tau_s}",
    acts_on="(1)",
    equation="i_c = (1 - a) i_1 + a i_2, T_A i_1' + i_1 = K_A u_c, tau i_2' + i_2 = K_A u_c",
    source="A. E. Fitzgerald, Ch. Kingsley, Electric Machinery, 2003: a winding beside a short-circuited one",
    parameters=(
        CauseParameter(name="share", symbol="a", index=SHARE, low=-0.5, high=0.9, probes=(0.05,)),
        CauseParameter(
            name="tau_s",
            symbol="tau",
            unit="s",
            index=TAU,
            neutral=5e-3,
            low=2e-4,
            high=5.0,
            probes=(5e-3,),
            logarithmic=True,
        ),
    ),
    signature="after a step of u_c most of i_c comes with T_A, and the rest with another time",
    shows_in=("amplifier-steps", "prbs-open-loop", "steps"),
    confirm="record a step of u_c that lasts ten times T_A: on a logarithmic scale the way to the end has two slopes",
    cure="a current loop in the amplifier, or the second pole in the design",
    needs=("u_c", "i_c"),
    deciding_measurements={"slew-rate-limit": OSCILLOSCOPE},
    traits=frozenset({"hidden-state"}),
    usual="within a few ticks",
    forms=(
        Form(
            name="within tenths of a second",
            values={"tau_s": 0.1},
            source="R. L. Stoll, The Analysis of Eddy Currents, 1974: the current of a magnet with a solid yoke",
            probed=True,
        ),
    ),
)


@inlined
def driven(c: Vector, i: float, second: float, target: float, T_A: float, h: float) -> tuple[float, float]:
    """Return (the current, i_2) after h s from i and `second`, A, under a constant `target`, A."""
    a = c[SHARE]
    after = settled(c, second, target, h)
    # Each part alone is an exact exponential; i_c is their weighted sum.
    first = target + ((i - a * second) / (1.0 - a) - target) * math.exp(-h / T_A)
    return (1.0 - a) * first + a * after, after


@inlined
def settled(c: Vector, second: float, target: float, h: float) -> float:
    """Return i_2 after h s under a constant target, A."""
    # Exactly: its time may be shorter than a substep, over which Euler's rule would overshoot.
    return target + (second - target) * math.exp(-h / c[TAU])


@inlined
def pull(c: Vector, second: float, target: float, T_A: float) -> float:
    """Return what i_2 adds to the target in T_A i_c' + i_c = target, A."""
    # From the derivative of i_c, with tau i_2' = e - i_2 in it.
    return c[SHARE] * (1.0 - T_A / c[TAU]) * (second - target)
