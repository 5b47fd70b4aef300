"""amplifier-gain-drift: the amplifier's gain falls under load.

    K_A (1 - loss w),   tau w' + w = i_c^n

A coil that heats has n = 2 and minutes, a supply that gives in has n = 1 and seconds.
"""

from __future__ import annotations

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector
from twin.model.causes.instruments import CLAMP_METER

LOSS, TAU, POWER = 0, 1, 127

CAUSE = Cause(
    name="amplifier-gain-drift",
    family="amplifier",
    title="the amplifier's gain falls under load",
    sentence="the amplifier's gain falls under load: by {loss_1_a2:%} at a lasting 1 A, within {tau_s}",
    opposite="the amplifier's gain grows under load: by {loss_1_a2:%} at a lasting 1 A, within {tau_s}",
    acts_on="target current of (1)",
    equation="K_A (1 - loss w), tau w' + w = i_c^n",
    source="the coil's resistance grows by 0.4 % per kelvin (the paper neglects it on purpose), or a supply gives in",
    parameters=(
        CauseParameter(name="loss_1_a2", symbol="loss", unit="1/A^2", index=LOSS, low=-0.05, high=0.3, probes=(0.02,)),
        CauseParameter(
            name="tau_s",
            symbol="tau",
            unit="s",
            index=TAU,
            neutral=30.0,
            low=0.5,
            high=3600.0,
            probes=(30.0,),
            logarithmic=True,
        ),
        CauseParameter(
            name="power", symbol="n", index=POWER, neutral=2.0, low=0.5, high=3.0, probes=(1.7,), spread=0.5
        ),
    ),
    signature="i_c / u_c falls under high current, over seconds (a supply) or minutes (a coil), and recovers in pauses",
    shows_in=("warm-run", "steps"),
    confirm="hold the ball low for a minute at constant u_c and watch i_c and the supply's voltage fall",
    cure="a current loop in the amplifier, or K_A scheduled with the mean square of i_c",
    deciding_measurements={"current-sensor-gain": CLAMP_METER},
    traits=frozenset({"warms"}),
    usual="a coil that heats",
    forms=(
        Form(
            name="a supply that gives in",
            values={"power": 1.0, "tau_s": 1.5},
            source="P. Horowitz, W. Hill, The Art of Electronics, 2015: the output resistance of a supply",
            probed=True,
        ),
    ),
)


@inlined
def gain(c: Vector, w: float) -> float:
    """Return the factor on K_A at warmth w, A^2."""
    # Linear, not 1 / (1 + loss w) as a resistance has it: at a loss of 3 % they differ by 0.1 %.
    return 1.0 - c[LOSS] * w


@inlined
def warmth_rate(c: Vector, i: float, w: float) -> float:
    """Return the time derivative of the warmth, A^2/s."""
    return (load(c, i) - w) / c[TAU]


@inlined
def load(c: Vector, i: float) -> float:
    """Return the warmth after a long time under the current i, A^2 (A^n where n is not 2)."""
    # The noise of a reading may make a current negative, which has no power that is not whole: it counts as none.
    return i * i if c[POWER] == 2.0 or c[LOSS] == 0.0 else max(i, 0.0) ** c[POWER]
