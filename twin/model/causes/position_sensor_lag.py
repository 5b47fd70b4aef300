"""position-sensor-lag: x is read through a slow sensor.

    r tau^2 s'' + tau s' + s = x

The lag is of first order with r = 0, two equal filters with r = 1/4, Butterworth's with r = 1/2.
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes import parabola
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

TAU, SECOND = 22, 44

CAUSE = Cause(
    name="position-sensor-lag",
    family="sensing",
    title="x is read through a slow sensor",
    sentence="x is read through a sensor that lags by {tau_s}",
    acts_on="position sensor",
    equation="r tau^2 s'' + tau s' + s = x",
    source="demodulator and anti-alias filter",
    parameters=(
        CauseParameter(name="tau_s", symbol="tau", unit="s", index=TAU, low=0.0, high=0.02, probes=(0.0002, 0.002)),
        CauseParameter(name="second", symbol="r", index=SECOND, low=0.0, high=1.0, probes=(0.1,), spread=0.4),
    ),
    signature="x lags what the forces say while i_c does not; impacts at the stops are rounded",
    shows_in=("prbs-open-loop", "prbs-reference"),
    confirm="tap the ball against its stop and compare x with a microphone",
    cure="a faster filter, or its pole in the observer and in the design",
    traits=frozenset({"hidden-state"}),
    usual="first order",
    forms=(
        Form(
            name="second order",
            values={"second": 0.5},
            source="U. Tietze, Ch. Schenk, Electronic Circuits, 2008: a filter of two poles",
            probed=True,
        ),
    ),
)


@inlined
def lagged(
    c: Vector, s: float, rate: float, reading: float, reading_half: float, reading_next: float, h: float
) -> tuple[float, float]:
    """Return (the sensor's output in m, its rate in m/s) after h s while its input follows a parabola.

    Args:
        c: the causes' parameters.
        s: output, m.
        rate: of the output, m/s; of a first order not looked at.
        reading: what the output would tend to at the beginning, m.
        reading_half: in the middle.
        reading_next: at the end.
        h: s.
    """
    tau, r = c[TAU], c[SECOND]
    if tau <= 0.0:
        return reading_next, 0.0
    # Not a straight line: that is wrong by a h^2 / 8 in the middle, 1 um for an acceleration a of 10 m/s^2 in 1 ms.
    slope, bend = parabola.through(reading, reading_half, reading_next, h)
    # The parabola that the output tends to: its slope at the beginning, its distance from the input at both ends.
    begin_rate, lead = slope - tau * bend, (1.0 - r) * tau * tau * bend
    behind, end = s - reading + tau * slope - lead, reading_next - tau * (slope + bend * h) + lead
    if r <= 0.0:
        return end + behind * math.exp(-h / tau), 0.0
    drift, mean = rate - begin_rate, -0.5 / (r * tau)
    square = mean * mean - 1.0 / (r * tau * tau)
    root = math.sqrt(abs(square))
    # Both poles are one, nearly: sinh and sine over the root are h, where the others would divide 0 by 0.
    if root * h < 1e-6:
        even = math.exp(mean * h)
        uneven = h * even
    elif square > 0.0:
        slow, fast = math.exp((mean + root) * h), math.exp((mean - root) * h)
        even, uneven = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    else:
        decay = math.exp(mean * h)
        even, uneven = decay * math.cos(root * h), decay * math.sin(root * h) / root
    after = even * behind + uneven * (drift - mean * behind)
    turned = even * drift + uneven * (mean * drift - behind / (r * tau * tau))
    return end + after, begin_rate + bend * h + turned
