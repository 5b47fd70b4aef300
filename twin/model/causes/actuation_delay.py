"""actuation-delay: the input acts later than the board says.

u_c(t - delay) in the control loop, u_c(t - r delay) in a capture, which counts its time from its own step.  Either the
amplifier is late (r = 1), or the output of a loop that computes before (r = 0).

A delay may be drawn anew at each tick: `delay` is then its mean, and `jitter` its standard deviation.  So the current
of (1) has a disturbance in proportion to the change of u_c: K_A (u - u_before) (exp(-(t - s) / T_A) - its mean) for an
input that acts at s.  A simulation has none.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, MeasuredProbes, Vector
from twin.model.causes.instruments import OSCILLOSCOPE

DELAY, IN_CAPTURES, JITTER = 8, 109, 129
# The likelihood of a delay has a kink at every whole interval.
AT_THE_KINKS = MeasuredProbes(of="sampling-interval", times=(0.5, 1.5))


def in_captures(index: int) -> CauseParameter:
    """The share of a delay that captures show."""
    return CauseParameter(
        name="in_captures", symbol="r", index=index, neutral=1.0, low=0.0, high=1.5, probes=(0.8,), spread=0.7
    )


CAUSE = Cause(
    name="actuation-delay",
    family="amplifier",
    title="the input acts later than the board says",
    sentence="the input acts {delay_s} later than the board says",
    acts_on="input of (1)",
    equation="u_c(t - delay); in a capture u_c(t - r delay)",
    source="computing time between sampling and output, or an output that is latched at the next tick",
    parameters=(
        CauseParameter(name="delay_s", symbol="delay", unit="s", index=DELAY, low=0.0, high=0.02, probes=(0.0002,)),
        in_captures(IN_CAPTURES),
        CauseParameter(
            name="jitter_s",
            symbol="jitter",
            unit="s",
            index=JITTER,
            low=0.0,
            high=0.01,
            probes=(0.0002,),
            spread=0.001,
            random=True,
        ),
    ),
    signature="i_c begins to move a fixed time after u_c, whatever the size of the step; in a capture as well, unless "
    "it is the loop's output that is late",
    shows_in=("amplifier-steps", "prbs-reference"),
    confirm="trigger an oscilloscope on the board's output pin and see when i_c begins",
    cure="output right after the computation, or predict the state by that time in the law",
    needs=("u_c", "i_c"),
    deciding_measurements={"sampling-delay": OSCILLOSCOPE, "position-sensor-lag": OSCILLOSCOPE},
    traits=frozenset({"delays", "hidden-state"}),
    usual="delay of the amplifier",
    forms=(
        Form(
            name="computing time of the loop",
            values={"in_captures": 0.0},
            source="K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 1997, ch. 9: computational delay",
            probed=True,
        ),
        Form(
            name="delay that is drawn at each tick",
            values={"jitter_s": 0.0002},
            source="J. Nilsson, Real-Time Control Systems with Delays, 1998",
        ),
    ),
    measured_probes=AT_THE_KINKS,
)


@inlined
def reach_s(c: Vector) -> float:
    """Return how far from its mean a delay may be, s: it is drawn evenly."""
    return math.sqrt(3.0) * c[JITTER]


@inlined
def disturbance(c: Vector, T_A: float, since_s: float, T_s: float) -> tuple[float, float, float]:
    """Return what the jitter of one change of the input adds in an interval, over K_A times that change.

    Args:
        c: the causes' parameters, shape (PLACES,), with a jitter.
        T_A: of the paper, s.
        since_s: from the change, at its mean delay, to the end of the interval, s; negative before it.
        T_s: the interval, s.

    Returns:
        Standard deviations of the current at the end and of the area below the current, s; and how long, on average,
        the ball has moved by that area at the end, s.
    """
    a = reach_s(c)
    before = math.exp(-2.0 * T_s / T_A) * _variance(a, T_A, since_s - T_s)
    of_i = math.sqrt(max(_variance(a, T_A, since_s) - before, 0.0))
    # The area between the responses to two delays is their difference in the end.  T_A of_i of it is still to come.
    decided = min(max(since_s, -a), a) - min(max(since_s - T_s, -a), a)
    area = max(c[JITTER] * math.sqrt(decided / (2.0 * a)) - T_A * of_i, 0.0)
    acted = min(since_s, T_s)
    return of_i, area, acted / (1.0 - math.exp(-acted / T_A)) - T_A if acted > 0.0 else 0.0


@inlined
def _variance(a: float, T_A: float, since_s: float) -> float:
    """Return the variance of exp(-(since_s - s) / T_A), 1 before s, for an s drawn evenly between -a and a."""
    if since_s <= -a:
        return 0.0
    s = min(since_s, a)
    begin, end, later = math.exp(-(since_s + a) / T_A), math.exp(-(since_s - s) / T_A), a - s
    mean = (later + T_A * (end - begin)) / (2.0 * a)
    return (later + 0.5 * T_A * (end * end - begin * begin)) / (2.0 * a) - mean * mean
