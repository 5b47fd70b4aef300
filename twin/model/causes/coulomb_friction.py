"""coulomb-friction: dry friction holds and brakes the ball."""

from __future__ import annotations

import math

from twin.compiled import inlined
from twin.model.causes.cause import Cause, CauseParameter, Form, Vector

FORCE, SLOW, EXTRA = 15, 40, 41

CAUSE = Cause(
    name="coulomb-friction",
    family="motion",
    title="dry friction holds and brakes the ball",
    sentence="dry friction of {force_n} holds and brakes the ball",
    acts_on="net force of (6)",
    equation="F_f (1 + e exp(-(x' / v_s)^2)) sign(x'), and up to F_f (1 + e) at rest",
    source="a ball that touches its guide",
    parameters=(
        CauseParameter(name="force_n", symbol="F_f", unit="N", index=FORCE, low=0.0, high=0.05, probes=(0.0005, 0.004)),
        CauseParameter(name="extra", symbol="e", index=EXTRA, low=0.0, high=2.0, probes=(0.1,), spread=0.5),
        CauseParameter(
            name="slow_m_s",
            symbol="v_s",
            unit="m/s",
            index=SLOW,
            neutral=0.01,
            low=0.001,
            high=0.1,
            probes=(0.013,),
            spread=0.02,
        ),
    ),
    signature="the ball sticks and slips under a slow reference; i_c at one height differs between rising and sinking",
    shows_in=("slow-ramp", "multisine"),
    confirm="move the reference slowly up and down and compare i_c at the same height",
    cure="free the ball from its guide, level the rig",
    traits=frozenset({"sticks"}),
    usual="Coulomb's: the same at every speed",
    forms=(
        Form(
            name="Stribeck's: more at low speed",
            values={"extra": 0.5},
            source="R. Stribeck 1902, in B. Armstrong-Helouvry, Control of Machines with Friction, 1991",
        ),
    ),
)


@inlined
def static_friction(c: Vector, mass_kg: float) -> float:
    """The acceleration up to which friction holds the ball, m/s^2."""
    return c[FORCE] * (1.0 + c[EXTRA]) / mass_kg


@inlined
def brakes(c: Vector, mass_kg: float, v: float, free: float) -> float:
    """The deceleration of a ball at speed v, signed as the motion it opposes, m/s^2; 0 if it holds the ball.

    Args:
        c: the causes' parameters.
        mass_kg: of the ball.
        v: its speed, m/s.
        free: its acceleration without dry friction, m/s^2.
    """
    friction = static_friction(c, mass_kg)
    # Exactly 0, without a band of speeds that count as rest (D. Karnopp, 1985): `turned` finds the standstill.
    if v == 0.0 and abs(free) <= friction:
        return 0.0
    if c[EXTRA] != 0.0:
        ratio = v / c[SLOW]
        friction = c[FORCE] * (1.0 + c[EXTRA] * math.exp(-ratio * ratio)) / mass_kg
    return math.copysign(friction, v if v != 0.0 else free)


@inlined
def let_go(friction: float, before: float, after: float, h: float) -> tuple[float, float]:
    """Return (speed in m/s, path in m) of a ball h s after it stood still.

    Its free acceleration goes straight from `before` to `after`; `friction`, m/s^2, holds or brakes it at most.
    """
    direction = math.copysign(1.0, after if abs(before) <= friction else before)
    first, last = direction * before - friction, direction * after - friction
    # Held until the free acceleration, a straight line, exceeds the friction.
    if first < 0.0:
        if last <= 0.0:
            return 0.0, 0.0
        h *= last / (last - first)
        first = 0.0
    last = max(last, 0.0)
    # The integrals of an acceleration that goes straight from `first` to `last`.
    return 0.5 * direction * (first + last) * h, direction * (2.0 * first + last) * h * h / 6.0


@inlined
def turned(
    friction: float, v: float, v_next: float, path: float, before: float, after: float, h: float
) -> tuple[float, float]:
    """Return (speed in m/s, path in m) of a ball that stops within h s; `let_go` handles the rest of the interval.

    Args:
        friction: that friction brakes, m/s^2.
        v: speed at the beginning, m/s.
        v_next: speed at the end had friction not turned round at the standstill, of the other sign.
        path: m, likewise.
        before: free acceleration at the beginning, m/s^2.
        after: at the end.
        h: s.
    """
    # The standstill by a straight line between the two speeds.
    left = h * v_next / (v_next - v)
    at_rest = after + (before - after) * left / h
    speed, further = let_go(friction, at_rest, after, left)
    return speed, path - 0.5 * v_next * left + further
