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
    sentence="x is read through a sensor that lags by {tau_s}",
    acts_on="position sensor",
    equation="tau s' + s = x",
    source="demodulator and anti-alias filter",
    parameters=(
        CauseParameter(
            name="tau_s", symbol="tau", unit="s", place=TAU, neutral=0.0, low=0.0, high=0.02, probes=(0.0002, 0.002)
        ),
    ),
    signature="x lags what the forces say while i_c does not; impacts at the stops are rounded",
    shows_in=("prbs-open-loop", "prbs-reference"),
    confirm="tap the ball against its stop and compare x with a microphone",
    cure="a faster filter, or its pole in the observer and in the design",
    traits=frozenset({"hidden-state"}),
)


@kernel
def lagged(c: Vector, s: float, reading: float, reading_next: float, h: float) -> float:
    """The sensor's output after h s while what it sees goes from one reading to the next, m."""
    if c[TAU] <= 0.0:
        return reading_next
    slope = (reading_next - reading) / h
    return reading_next - slope * c[TAU] + (s - reading + slope * c[TAU]) * math.exp(-h / c[TAU])
