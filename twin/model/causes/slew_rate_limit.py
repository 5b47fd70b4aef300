"""slew-rate-limit: the current cannot change faster than a certain rate."""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, MeasuredProbes, Vector

RATE = 3

CAUSE = Cause(
    name="slew-rate-limit",
    family="amplifier",
    title="the current cannot change faster than a certain rate",
    sentence="the current cannot change faster than {rate_a_s}",
    acts_on="rate of the current in (1)",
    equation="|di_c/dt| <= r",
    source="the voltage at the coil is finite: |di_c/dt| <= U / L",
    parameters=(
        CauseParameter(
            name="rate_a_s",
            symbol="r",
            unit="A/s",
            index=RATE,
            neutral=math.inf,
            low=0.5,
            high=1000000.0,
            probes=(3000.0, 1000.0, 300.0, 100.0, 30.0),
        ),
    ),
    signature="large steps of i_c are ramps of one slope, small ones exponentials; T_A seems to grow with the step",
    shows_in=("amplifier-steps", "prbs-open-loop"),
    confirm="compare the 25 kHz responses to a small and to a large step of u_c: the large one is a straight "
    "line at first",
    cure="a higher supply voltage, or a law that asks for smaller steps of u_c",
    needs=("u_c", "i_c"),
    measured_probes=MeasuredProbes(of="fastest-change", times=(1.3, 1.0, 0.7, 0.4)),
)


@inlined
def relaxed(c: Vector, i: float, target: float, T_A: float, h: float) -> float:
    """The current after h s on its way to a constant target: exponential, but never faster than the rate, A."""
    away = target - i
    rate = c[RATE]
    fast = abs(away) - rate * T_A  # beyond this distance the exponential would be faster than the rate
    # Ramp, then exponential: the distance to the target only falls, so the order is never the other one.
    if fast > 0.0:
        ramp = fast / rate
        if ramp >= h:
            return i + math.copysign(rate * h, away)
        i += math.copysign(fast, away)
        h -= ramp
    return target + (i - target) * math.exp(-h / T_A)


@inlined
def time_to(c: Vector, i: float, end: float, target: float, T_A: float) -> float:
    """The time in which `relaxed` takes the current from i to `end`, which lies between i and its target, s."""
    slow = c[RATE] * T_A  # nearer to the target than this, the exponential is slower than the rate
    ramp = min(max(abs(target - i) - slow, 0.0), abs(end - i))
    t = ramp / c[RATE]
    away = abs(target - i) - ramp
    return t + T_A * math.log(away / abs(target - end)) if away > abs(target - end) else t
