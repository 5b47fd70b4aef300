"""amplifier-gain-drift: the amplifier's gain falls as the coil heats."""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Vector
from twin.model.causes.instruments import CLAMP_METER

LOSS, TAU = 0, 1

CAUSE = Cause(
    name="amplifier-gain-drift",
    family="amplifier",
    title="the amplifier's gain falls as the coil heats",
    sentence="the amplifier's gain falls as the coil heats: by {loss_1_a2:%} at a lasting 1 A, within {tau_s}",
    opposite="the amplifier's gain grows as the coil heats: by {loss_1_a2:%} at a lasting 1 A, within {tau_s}",
    acts_on="target current of (1)",
    equation="K_A (1 - loss w), tau w' + w = i_c^2",
    source="the coil's resistance grows by 0.4 % per kelvin; the paper neglects it on purpose",
    parameters=(
        CauseParameter(name="loss_1_a2", symbol="loss", unit="1/A^2", index=LOSS, low=-0.05, high=0.3, probes=(0.02,)),
        CauseParameter(
            name="tau_s", symbol="tau", unit="s", index=TAU, neutral=30.0, low=5.0, high=600.0, probes=(30.0,)
        ),
    ),
    signature="i_c / u_c falls over tens of seconds of high current and recovers in pauses",
    shows_in=("warm-run", "steps"),
    confirm="hold the ball low for a minute at constant u_c and watch i_c fall; let the coil cool and compare",
    cure="a current loop in the amplifier, or K_A scheduled with the mean square of i_c",
    deciding_measurements={"current-sensor-gain": CLAMP_METER},
    traits=frozenset({"warms"}),
)


@inlined
def gain(c: Vector, w: float) -> float:
    """Return the factor on K_A at warmth w, A^2."""
    return 1.0 - c[LOSS] * w


@inlined
def warmth_rate(c: Vector, i: float, w: float) -> float:
    """Return the time derivative of the warmth, A^2/s."""
    return (i * i - w) / c[TAU]
