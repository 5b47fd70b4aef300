"""second-time-constant: the current of the coil has a second time constant.

    T_A i' + i = e + s (z - i),   tau z' + z = i

e is the current that the amplifier tends to, and s (z - i) what a second winding induces: a frame, a yoke or a solid
core.  Its own current decays with tau.
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
    title="the current has a second time constant",
    sentence="the current has a second time constant of {tau_s}, with the weight s = {share}",
    acts_on="(1)",
    equation="T_A i' + i = K_A u_c + s (z - i), tau z' + z = i",
    source="A. E. Fitzgerald, Ch. Kingsley, Electric Machinery, 2003: a short-circuited second winding",
    parameters=(
        CauseParameter(name="share", symbol="s", index=SHARE, low=0.0, high=5.0, probes=(0.1,)),
        CauseParameter(
            name="tau_s", symbol="tau", unit="s", index=TAU, neutral=5e-3, low=2e-4, high=5.0, probes=(5e-3,)
        ),
    ),
    signature="after a step of u_c most of i_c comes with T_A, and the rest with a longer time",
    shows_in=("amplifier-steps", "prbs-open-loop", "steps"),
    confirm="record a step of u_c that is ten times longer than T_A: on a logarithmic scale what lacks has two slopes",
    cure="a current loop in the amplifier, or the second pole in the design",
    needs=("u_c", "i_c"),
    deciding_measurements={"slew-rate-limit": OSCILLOSCOPE},
    usual="within a few ticks",
    forms=(
        Form(
            name="within tenths of a second",
            values={"tau_s": 0.1},
            source="a solid yoke of iron, W. R. Smythe, Static and Dynamic Electricity, 1950",
            probed=True,
        ),
    ),
    traits=frozenset({"hidden-state"}),
)


@inlined
def driven(c: Vector, i: float, z: float, target: float, T_A: float, h: float) -> tuple[float, float]:
    """Return (the current, the lagging current) after h s from i and z, A, under a constant `target`, A."""
    s, tau = c[SHARE], c[TAU]
    a, q = i - target, z - target
    mean = -0.5 * ((1.0 + s) / T_A + 1.0 / tau)
    half = -0.5 * ((1.0 + s) / T_A - 1.0 / tau)
    root = math.sqrt(half * half + s / (T_A * tau))
    slow, fast = math.exp((mean + root) * h), math.exp((mean - root) * h)
    even, uneven = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    return (
        target + even * a + uneven * (half * a + s / T_A * q),
        target + even * q + uneven * (a / tau - half * q),
    )


@inlined
def lagged(c: Vector, z: float, i: float, i_next: float, h: float) -> float:
    """The lagging current after h s while the current goes from i to i_next, A."""
    tau, slope = c[TAU], (i_next - i) / h
    return i_next - slope * tau + (z - i + slope * tau) * math.exp(-h / tau)
