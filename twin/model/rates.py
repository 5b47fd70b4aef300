"""The model as a differential equation, (11)-(12) with causes, for tools that integrate by themselves.

`integration.advance` integrates the same equation with the input held; tests/twin/model/test_rates.py compares the two.

Rule 1: the state is [i_c, x, x'].  A cause with a state of its own, or that holds the ball, has no such equation:
        `without_equation` says which and why.
Rule 2: stops are left to the caller.
"""

from __future__ import annotations

from twin.model.causes import air_gap_offset, motional_emf, position_dependent_inductance, slew_rate_limit
from twin.model.causes import freewheel_diode as diode
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Trait, Vector
from twin.model.extended import (
    GAP_MIN_SHARE,
    Base,
    acceleration,
    current_reading,
    drive,
    induced_lead,
    position_reading,
)
from twin.model.parameters import Model

_WHY: dict[Trait, str] = {
    "delays": "its state is the past of a signal",
    "hidden-state": "it has a state beside [i_c, x, x']",
    "warms": "it has a state beside [i_c, x, x']",
    "sticks": "a ball that sticks follows no differential equation",
}


def without_equation(model: Model) -> list[str]:
    """Return the sentences on the causes of a model that [i_c, x, x'] cannot have."""
    sentences = []
    for cause in model.causes:
        traits = BY_NAME[cause.name].traits
        why = next((text for trait, text in _WHY.items() if trait in traits), None)
        if why:
            sentences.append(f"{cause.name}: {why}")
    return sentences


def rates(p: Base, c: Vector, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """Return (i_c', x', x'') of (1) and (6) with the causes of a model, in A/s, m/s, m/s^2, away from the stops.

    Args:
        p: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        i: current, A.
        x: position, m.
        v: speed, m/s.
        u: input, V.
    """
    plane, gap_mid = air_gap_offset.gap_m(c, p.x_max_m), p.x_max_m - 0.5 * p.travel_m
    gap = max(plane - x, GAP_MIN_SHARE * p.travel_m)
    # Cold: a model that warms has a state more, and never comes here (`without_equation`).
    target = drive(p, c, u, 0.0) - p.K_A * diode.lost_v(c, u, i, p.K_A)
    T_A = position_dependent_inductance.time_constant(c, p.T_A, gap, plane, gap_mid)
    resisted = i
    if c[motional_emf.COUPLING] != 0.0 or c[position_dependent_inductance.VOLTAGE] != 0.0:
        resisted = i * induced_lead(p, c, v, gap)
    # (1): T_A i_c' + i_c = target.
    rate = (target - resisted) / T_A
    fastest = c[slew_rate_limit.RATE]
    # Limited last: a slew rate bounds the result, whatever the other causes make of it.
    return max(min(rate, fastest), -fastest), v, acceleration(p, c, i, x, v, 0.0, True)


def readings(p: Base, c: Vector, i: float, x: float) -> tuple[float, float]:
    """Return the readings of i_c and x, A and m, of sensors without a lag."""
    return current_reading(c, i), position_reading(p, c, x, i)
