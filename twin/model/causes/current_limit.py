"""current-limit: the amplifier gives no more than a certain current."""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, MeasuredProbes, Vector
from twin.model.causes.instruments import CLAMP_METER

LIMIT, SOFTNESS, FOLD = 2, 32, 46
MIN_SOFTNESS = 0.005  # below it the knee counts as hard

CAUSE = Cause(
    name="current-limit",
    family="amplifier",
    title="the amplifier gives no more than a certain current",
    sentence="the amplifier gives no more than {limit_a}",
    acts_on="target current of (1)",
    equation="i_c tends to g - f (K_A u_c - g), g = K_A u_c / (1 + (K_A u_c / i_limit)^(1/s))^s; s = f = 0: <= i_limit",
    source="a power supply, or a protection, smaller than the rig asks for",
    parameters=(
        CauseParameter(
            name="limit_a",
            symbol="i_limit",
            unit="A",
            index=LIMIT,
            neutral=math.inf,
            low=0.02,
            high=20.0,
            probes=(2.0, 1.5, 1.2, 1.05, 0.9),
        ),
        # A softer knee, such as a cube of u_c, bends the gain at all inputs, and its limit lies far beyond the data.
        CauseParameter(name="softness", symbol="s", index=SOFTNESS, low=0.0, high=0.25, probes=(0.05,), spread=0.2),
        CauseParameter(name="fold", symbol="f", index=FOLD, low=0.0, high=1.0, probes=(0.1,), spread=0.3),
    ),
    signature="i_c stays flat at one value while u_c still rises",
    shows_in=("lift-off", "amplifier-steps"),
    confirm="block the ball, turn u_c up slowly and watch where i_c stops rising",
    cure="a larger supply; until then set the board's u_max below the limit, so that the integral does not wind up",
    needs=("u_c", "i_c"),
    deciding_measurements={"current-sensor-gain": CLAMP_METER},
    measured_probes=MeasuredProbes(of="largest-current", times=(1.02, 1.0, 0.98, 0.93)),
    usual="hard limit",
    forms=(
        Form(
            name="soft knee",
            values={"softness": 0.1},
            source="C. Rapp, Effects of HPA-nonlinearity on a 4-DPSK/OFDM-signal, 1991",
            probed=True,
        ),
        Form(
            name="foldback",
            values={"fold": 0.3},
            source="P. Horowitz, W. Hill, The Art of Electronics, 2015: more demand, less current",
        ),
    ),
)


@inlined
def limited(c: Vector, i: float) -> float:
    """The current that the supply allows, A."""
    return min(i, c[LIMIT])


@inlined
def aimed_at(c: Vector, target: float) -> float:
    """The current, A, that the amplifier tends to; `target`: the same without a limit, A, not negative."""
    if math.isinf(c[LIMIT]):
        return target
    # The exponent would be above 200 there, and the power of a large input infinite.
    if c[SOFTNESS] < MIN_SOFTNESS:
        limited = min(target, c[LIMIT])
    else:
        # C. Rapp, 1991, the limiter of an amplifier.
        limited = target / (1.0 + (target / c[LIMIT]) ** (1.0 / c[SOFTNESS])) ** c[SOFTNESS]
    return float(max(limited - c[FOLD] * (target - limited), 0.0))
