"""freewheel-diode: while the driver is off, the coil's current flows through a diode, which takes its voltage off."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector

DROP = 28
_FADES = 0.5  # of K_A V_D: nearer to the current of rest conduction is not continuous, and the loss ends with it

CAUSE = Cause(
    name="freewheel-diode",
    family="amplifier",
    title="while the driver is off, the coil's current flows on through a diode, which brakes it",
    sentence="while the driver is off, the coil's current flows on through a diode that takes {drop_v} off its voltage",
    acts_on="input of (1)",
    equation="T_A i_c' + i_c = K_A (u_c - max(V_D - u_c, 0)) while i_c > K_A u_c",
    source="a PWM driver gives duty (V_s + V_D) - V_D on average while current flows, but no less than 0 at rest",
    parameters=(
        CauseParameter(name="drop_v", symbol="V_D", unit="V", index=DROP, low=0.0, high=3.0, probes=(0.05, 0.5)),
    ),
    signature="i_c falls faster than it rises, and reaches 0 in finite time, after a step of u_c to 0",
    shows_in=("amplifier-steps", "blocked-ball"),
    confirm="step u_c up and back to 0 with an oscilloscope on the coil: its voltage goes below 0 until i_c has ended",
    cure="a full-bridge or current-controlled driver, or a law whose input stays above V_D",
    needs=("u_c", "i_c"),
)


@inlined
def lost_v(c: Vector, u: float, i: float, K_A: float) -> float:
    """Return the voltage that the diode takes off u_c, V."""
    drop = c[DROP]
    u = max(u, 0.0)
    above = i - K_A * u  # at rest u_c is what the coil gets: it was calibrated there
    if drop <= 0.0 or u >= drop or above <= 0.0:
        return 0.0
    return (drop - u) * min(1.0, above / (_FADES * K_A * drop))
