"""current-sensor-lag: i_c is read through a slow sensor.

tau s' + s = i_c
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes import parabola
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import OSCILLOSCOPE

TAU = 128

CAUSE = Cause(
    name="current-sensor-lag",
    family="sensing",
    title="i_c is read through a slow sensor",
    sentence="i_c is read through a sensor that lags by {tau_s}",
    acts_on="current sensor",
    equation="tau s' + s = i_c",
    source="a low-pass filter before the converter, as against aliasing",
    parameters=(
        CauseParameter(name="tau_s", symbol="tau", unit="s", index=TAU, low=0.0, high=0.05, probes=(0.0002, 0.002)),
    ),
    signature="i_c lags what the ball shows of the force; after a step of u_c it begins without a corner",
    shows_in=("prbs-open-loop", "prbs-reference", "amplifier-steps"),
    confirm="compare i_c with a clamp meter of a high bandwidth on an oscilloscope",
    cure="a faster filter, or its pole in the observer and in the design",
    deciding_measurements={"actuation-delay": OSCILLOSCOPE, "second-time-constant": OSCILLOSCOPE},
    traits=frozenset({"hidden-state"}),
)


@inlined
def lagged(c: Vector, s: float, i: float, i_half: float, i_next: float, h: float) -> float:
    """The sensor's output after h s while the current goes from i by i_half to i_next on a parabola, A."""
    tau = c[TAU]
    if tau <= 0.0:
        return i_next
    slope, bend = parabola.through(i, i_half, i_next, h)
    # The parabola that the output tends to, at both ends.
    begin, end = i - tau * slope + tau * tau * bend, i_next - tau * (slope + bend * h) + tau * tau * bend
    return end + (s - begin) * math.exp(-h / tau)


@inlined
def shown(c: Vector, s: float, i: float) -> float:
    """Return the current that the sensor shows, A, of its output and the current."""
    return s if c[TAU] > 0.0 else i
