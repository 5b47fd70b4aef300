"""periodic-disturbance: a periodic force shakes the ball.

F (sin w + sum over k = 2, 3 of a_k sin(k w) + b_k cos(k w)),   w = 2 pi f t + phase
"""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

AMPLITUDE, FREQUENCY = 17, 18
SINE_2, COSINE_2, SINE_3, COSINE_3 = range(150, 154)  # shares of the amplitude

CAUSE = Cause(
    name="periodic-disturbance",
    family="motion",
    title="a periodic force shakes the ball",
    sentence="a periodic force of {amplitude_n} at {frequency_hz} shakes the ball",
    acts_on="net force of (6)",
    equation="m x'' = ... + F sin(2 pi f t + phase), and harmonics",
    source="floor vibration, a fan, a motor on the same table",
    parameters=(
        CauseParameter(name="amplitude_n", symbol="F", unit="N", index=AMPLITUDE, low=0.0, high=0.05, probes=(0.0005,)),
        CauseParameter(
            name="frequency_hz", symbol="f", unit="Hz", index=FREQUENCY, neutral=7.0, low=0.5, high=100.0, probes=(7.0,)
        ),
        *(
            CauseParameter(name=name, symbol=symbol, index=index, low=-1.5, high=1.5, probes=(0.1,), spread=0.3)
            for name, symbol, index in (
                ("sine_2", "a_2", SINE_2),
                ("cosine_2", "b_2", COSINE_2),
                ("sine_3", "a_3", SINE_3),
                ("cosine_3", "b_3", COSINE_3),
            )
        ),
    ),
    signature="one line in the spectrum of the prediction errors, at the same frequency in every recording",
    shows_in=("steps", "multisine", "holds"),
    confirm="switch off what turns nearby, or put the rig on another table, and see whether the line goes",
    cure="a quiet table; else a notch, or a resonator at that frequency in the law",
    detector="spectral-line",
    not_simulated="its phase is not known",
    usual="a pure sinusoid",
    forms=(
        Form(name="a rectangle", values={"sine_3": 1.0 / 3.0}, source="the Fourier series of what switches on and off"),
    ),
)


@inlined
def force_n(c: Vector, t: float) -> float:
    """The force upwards at time t, N; the phase of a recording is in its t."""
    if c[AMPLITUDE] == 0.0:
        return 0.0
    angle = 2.0 * math.pi * c[FREQUENCY] * t
    s, k = math.sin(angle), math.cos(angle)
    second = c[SINE_2] * 2.0 * s * k + c[COSINE_2] * (1.0 - 2.0 * s * s)
    third = c[SINE_3] * s * (3.0 - 4.0 * s * s) + c[COSINE_3] * k * (4.0 * k * k - 3.0)
    return c[AMPLITUDE] * (s + second + third)
