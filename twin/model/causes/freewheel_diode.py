"""freewheel-diode: while the driver is off, the coil's current flows through a diode, which takes its voltage off."""

from __future__ import annotations

import math

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


@inlined
def piece(c: Vector, u: float, i: float, K_A: float, T_A: float, target: float) -> tuple[float, float, float]:
    """Return (where the current tends to, A; its time constant, s; the current at which this ceases to hold, A).

    The voltage that the diode takes off is a piecewise linear function of the current, so the response is exponential
    within each of three ranges: below the current of rest, where the diode fades, and above.

    Args:
        c: the causes' parameters.
        u: u_c, V.
        i: current, A.
        K_A: A/V.
        T_A: s.
        target: where the current tends to without the diode, A.
    """
    drop, u = c[DROP], max(u, 0.0)
    if drop <= 0.0 or u >= drop:
        return target, T_A, math.inf if target >= i else -math.inf
    rest, lost = K_A * u, K_A * (drop - u)
    whole, steeper = rest + _FADES * K_A * drop, 1.0 + (drop - u) / (_FADES * drop)
    # A current on a border belongs to the range that it moves into.
    rises = target - K_A * lost_v(c, u, i, K_A) > i
    if i > whole or (rises and i == whole):
        return target - lost, T_A, math.inf if rises else whole
    if i > rest or (rises and i == rest):
        # T_A i' + i = target - (steeper - 1) (i - rest): a loss that fades acts as a resistance.
        return (target + (steeper - 1.0) * rest) / steeper, T_A / steeper, whole if rises else rest
    return target, T_A, rest if rises else -math.inf
