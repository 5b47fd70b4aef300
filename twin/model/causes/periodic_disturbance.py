"""periodic-disturbance: a periodic force shakes the ball."""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector

AMPLITUDE, FREQUENCY = 17, 18

CAUSE = Cause(
    name="periodic-disturbance",
    family="motion",
    title="a periodic force shakes the ball",
    sentence="a periodic force of {amplitude_n} at {frequency_hz} shakes the ball",
    acts_on="net force of (6)",
    equation="m x'' = ... + F sin(2 pi f t + phase)",
    source="floor vibration, a fan, a motor on the same table",
    parameters=(
        CauseParameter(name="amplitude_n", symbol="F", unit="N", index=AMPLITUDE, low=0.0, high=0.05, probes=(0.0005,)),
        CauseParameter(
            name="frequency_hz", symbol="f", unit="Hz", index=FREQUENCY, neutral=7.0, low=0.5, high=100.0, probes=(7.0,)
        ),
    ),
    signature="one line in the spectrum of the prediction errors, at the same frequency in every recording",
    shows_in=("steps", "multisine", "holds"),
    confirm="switch off what turns nearby, or put the rig on another table, and see whether the line goes",
    cure="a quiet table; else a notch, or a resonator at that frequency in the law",
    detector="spectral-line",
    not_simulated="its phase is not known",
)


@inlined
def force_n(c: Vector, t: float) -> float:
    """The force upwards at time t, N; the phase of a recording is in its t."""
    if c[AMPLITUDE] == 0.0:
        return 0.0
    return c[AMPLITUDE] * math.sin(2.0 * math.pi * c[FREQUENCY] * t)
