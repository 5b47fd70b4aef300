"""One tick of the model, causes included, with the input held: `extended.advance` and the delays around it.

Rule 1: the sample grid is the clock.  One call is one T_s; what happens at a tick happens between two calls.
Rule 2: there is one physics: a model without causes is (1) and (6) by the same kernel, with the neutral vector.
Rule 3: `actuation-delay` holds back u_c, `sampling-delay` what the sensors show.  Readings are what a board would get:
        sensors' causes, lag and delay included, noise not.
Rule 4: the phase of a periodic force is unknown to a simulation, so it runs without that force (`left_out` says so);
        lost samples are the line's, not the rig's.

Memory of a simulated rig, shape (`places`,): the state of `extended.py` (0..6), the readings shown at this tick
(I_READ, X_READ), two places of the law that closes the loop (INTEGRAL, X_BEFORE), the inputs that still have to act,
newest first, then pairs of readings that still have to show.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.model.causes import actuation_delay, periodic_disturbance, sampling_delay
from twin.model.causes.catalogue import BY_NAME
from twin.model.extended import (
    FIELD,
    I_C,
    RATE,
    SENSOR,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    current_of_reading,
    current_reading,
    over,
    position_of_reading,
    position_reading,
)
from twin.model.extension import base, vector
from twin.model.parameters import Model

I_READ, X_READ, INTEGRAL, X_BEFORE = range(STATES, STATES + 4)
LINES = STATES + 4
_SLIVER = 1e-9  # of a tick: rounding of a delay that is whole ticks


class PlantNumbers(NamedTuple):
    """The model as the kernels take it, for one T_s; made by `plant_numbers`."""

    base: Packed  # tuple(Base)
    c: NDArray[np.float64]  # the causes, shape (PLACES,)
    sample_time_s: float
    act_whole: int  # ticks by which the input acts late, and
    act_part_s: float  # what is left of the delay
    sense_whole: int  # the same of what the sensors show
    sense_part_s: float
    in_whole: int  # the same of their sum, for an observer that sees readings
    in_part_s: float
    closed_form: bool  # (1) and (6) and nothing else


def plant_numbers(model: Model, sample_time_s: float) -> PlantNumbers:
    """Freeze `model` for ticks of `sample_time_s`."""
    c = vector(model.causes)
    c[periodic_disturbance.AMPLITUDE] = 0.0
    act, sense = float(c[actuation_delay.DELAY]), float(c[sampling_delay.DELAY])
    return PlantNumbers(
        tuple(base(model)),
        c,
        sample_time_s,
        *_ticks(act, sample_time_s),
        *_ticks(sense, sample_time_s),
        *_ticks(act + sense, sample_time_s),
        not model.causes,
    )


def _ticks(delay_s: float, sample_time_s: float) -> tuple[int, float]:
    whole = math.floor(delay_s / sample_time_s + _SLIVER)
    part = delay_s - whole * sample_time_s
    return whole, part if part > _SLIVER * sample_time_s else 0.0


def left_out(model: Model) -> list[str]:
    """What of the model a simulation does without, and why."""
    why = {cause.name: BY_NAME[cause.name].not_simulated for cause in model.causes}
    return [f"{name} is not simulated: {reason}" for name, reason in why.items() if reason]


def places(plant: PlantNumbers) -> int:
    """Length of a simulated rig's memory."""
    return LINES + plant.act_whole + 2 + 2 * (plant.sense_whole + 1)


def rig_at(
    plant: PlantNumbers, *, i: float, x: float, v: float, u: float, warmth: float | None = None
) -> NDArray[np.float64]:
    """A rig whose sensors show i (A) and x (m), at the speed v (m/s), with u (V) in force for long.

    Args:
        plant: of `plant_numbers`.
        i: reading of the current.
        x: reading of the position; the ball is put within the stops.
        v: true speed.
        u: input so far.
        warmth: A^2; None: the coil has carried this current for long.
    """
    p, c = Base(*plant.base), plant.c
    memory = np.zeros(places(plant))
    current = current_of_reading(c, i)
    position = min(max(position_of_reading(p, c, x, current), 0.0), p.travel_m)
    memory[I_C], memory[X], memory[V], memory[FIELD] = current, position, v, current
    memory[SENSOR], memory[RATE] = position_reading(p, c, position, current), v
    memory[WARMTH] = current * current if warmth is None else warmth
    memory[I_READ], memory[X_READ] = current_reading(c, current), memory[SENSOR]
    late = LINES + plant.act_whole + 2
    memory[LINES:late] = u
    memory[late::2], memory[late + 1 :: 2] = memory[I_READ], memory[X_READ]
    return memory


@kernel
def hold(plant: Packed, memory: NDArray[np.float64], u: float) -> None:
    """One tick of the rig with u_c = u sent to it; memory, as at the top, is then that of the next tick."""
    p = PlantNumbers(*plant)
    T_s = p.sample_time_s
    if p.act_whole == 0 and p.act_part_s == 0.0 and p.sense_whole == 0 and p.sense_part_s == 0.0:
        over(p.base, p.c, memory, u, 0.0, T_s, True)
        memory[I_READ], memory[X_READ] = current_reading(p.c, memory[I_C]), memory[SENSOR]
        return
    last_u = LINES + p.act_whole + 1
    for k in range(last_u, LINES, -1):
        memory[k] = memory[k - 1]
    memory[LINES] = u
    last = last_u + 1 + 2 * p.sense_whole
    for k in range(last, last_u + 1, -2):
        memory[k], memory[k + 1] = memory[k - 2], memory[k - 1]
    change, look = p.act_part_s, T_s - p.sense_part_s  # within the tick: the input changes, the sensors are looked at
    at = 0.0
    for end in (min(change, look), max(change, look), T_s):
        if end > at:
            over(p.base, p.c, memory, memory[last_u] if at < change else memory[last_u - 1], 0.0, end - at, True)
            at = end
        if at == look:
            memory[last_u + 1], memory[last_u + 2] = current_reading(p.c, memory[I_C]), memory[SENSOR]
    memory[I_READ], memory[X_READ] = memory[last], memory[last + 1]
