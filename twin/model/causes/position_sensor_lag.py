"""position-sensor-lag: x is read through a slow sensor.

tau s' + s = x
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.model.causes.cause import Cause, CauseParameter, Vector

TAU = 22

CAUSE = Cause(
    name="position-sensor-lag",
    family="sensing",
    title="x is read through a slow sensor",
    acts_on="position sensor",
    equation="tau s' + s = x",
    source="demodulator and anti-alias filter",
    parameters=(
        CauseParameter(
            name="tau_s", symbol="tau", unit="s", place=TAU, neutral=0.0, low=0.0, high=0.02, probes=(0.0002,)
        ),
    ),
    signature="impacts at the stops are rounded; x lags what the forces say, i_c does not",
    shows_in=("prbs-open-loop", "prbs-reference"),
    confirm="tap the ball and compare x with a microphone",
    cure="a faster filter, or its pole in the observer",
)


@kernel
def lagged(c: Vector, s: float, reading: float, reading_next: float, h: float) -> float:
    """The sensor's output after h s while what it sees goes from one reading to the next, m."""
    if c[TAU] <= 0.0:
        return reading_next
    slope = (reading_next - reading) / h
    return reading_next - slope * c[TAU] + (s - reading + slope * c[TAU]) * math.exp(-h / c[TAU])
