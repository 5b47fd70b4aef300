"""Simulation of the model by ticks with the input held: `integration.advance` and the delays around it.

Rule 1: one call of `hold` advances the rig by one T_s.
Rule 2: a model without causes uses the same kernel with the neutral vector, which is (1) and (6).
Rule 3: `actuation-delay` delays u_c, `sampling-delay` the readings.  Readings include the sensors' causes, lag and
        delay, but no noise.
Rule 4: the phase of a periodic force is unknown, so the simulation leaves that force out and `left_out` reports it.
        Lost samples belong to the serial line and are not simulated either.

The memory of a simulated rig has shape (`places`,).  It begins with the state of `extended.py` and the readings of this
tick (I_READ, X_READ).  Two numbers of the control law (INTEGRAL, X_BEFORE) follow, then the delayed inputs, newest
first, then the pairs of delayed readings.
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
    RATE,
    SENSOR,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    current_of_reading,
    current_reading,
    position_of_reading,
    position_reading,
    reading_of_current,
    settle_current,
)
from twin.model.extension import base, vector
from twin.model.integration import STOPS, over
from twin.model.parameters import Model

I_READ, X_READ, INTEGRAL, X_BEFORE = range(STATES, STATES + 4)
LINES = STATES + 4
ACT, SENSE = actuation_delay.DELAY, sampling_delay.DELAY  # in the vector c
_SLIVER = 1e-9  # of a tick: rounding error of a delay of whole ticks


class PlantNumbers(NamedTuple):
    """The model in the form of the kernels, for one T_s; `plant_numbers` makes it."""

    base: Packed  # tuple(Base)
    c: NDArray[np.float64]  # the causes, shape (PLACES,)
    sample_time_s: float
    act_whole: int  # whole ticks of the actuation delay
    act_part_s: float  # the rest of it
    sense_whole: int  # whole ticks of the sampling delay
    sense_part_s: float  # the rest of it
    in_whole: int  # whole ticks of their sum: from u_c to the readings
    closed_form: bool  # whether the model is (1) and (6) without causes


def plant_numbers(model: Model, sample_time_s: float) -> PlantNumbers:
    """The model in the form of the kernels, for ticks of `sample_time_s`, s."""
    c = vector(model.causes)
    c[periodic_disturbance.AMPLITUDE] = 0.0
    act, sense = float(c[ACT]), float(c[SENSE])
    return PlantNumbers(
        tuple(base(model)),
        c,
        sample_time_s,
        *delay_in_ticks(act, sample_time_s),
        *delay_in_ticks(sense, sample_time_s),
        delay_in_ticks(act + sense, sample_time_s)[0],
        not model.causes,
    )


def delay_in_ticks(delay_s: float, sample_time_s: float) -> tuple[int, float]:
    """Return (whole ticks, the rest in s) of a delay."""
    # Two ticks may come out as 1.9999...: rounding must not make of them one tick and a part.
    whole = math.floor(delay_s / sample_time_s + _SLIVER)
    part = delay_s - whole * sample_time_s
    return whole, part if part > _SLIVER * sample_time_s else 0.0


def left_out(model: Model) -> list[str]:
    """Return the sentences on the causes that a simulation leaves out, with the reason."""
    why = {cause.name: BY_NAME[cause.name].not_simulated for cause in model.causes}
    return [f"{name} is not simulated: {reason}" for name, reason in why.items() if reason]


def places(plant: PlantNumbers) -> int:
    """Return the length of a simulated rig's memory."""
    return LINES + plant.act_whole + 2 + 2 * (plant.sense_whole + 1)


def rig_at(
    plant: PlantNumbers, *, i: float, x: float, v: float, u: float, warmth: float | None = None
) -> NDArray[np.float64]:
    """Return the memory of a rig with given readings and speed after a long time under constant input.

    Args:
        plant: of `plant_numbers`.
        i: reading of the current, A.
        x: reading of the position, m; the position is limited to the travel.
        v: true speed, m/s.
        u: input so far, V.
        warmth: A^2; None: that of a coil that has carried this current for a long time.

    Returns:
        The memory, shape (`places`,).
    """
    memory = np.zeros(places(plant))
    begin(plant, memory, i, x, v, u, -1.0 if warmth is None else warmth)
    return memory


def begin(
    plant: PlantNumbers, memory: NDArray[np.float64], i: float, x: float, v: float, u: float, warmth: float
) -> None:
    """Fill the memory of `rig_at`; a `warmth` below 0 is that of a coil that has carried its current for a long time.

    `twin/export` translates this function, as it does the kernels.
    """
    p, c = Base(*plant.base), plant.c
    current = current_of_reading(c, i)
    # Within the travel: the noise of a reading must not put the ball beyond a stop.
    position = min(max(position_of_reading(p, c, x, current), 0.0), p.travel_m)
    settle_current(c, memory, current)
    memory[X], memory[V] = position, v
    memory[SENSOR], memory[RATE] = position_reading(p, c, position, current), v
    # A sign, not None: the exported languages have numbers only.
    if warmth >= 0.0:
        memory[WARMTH] = warmth
    memory[I_READ], memory[X_READ] = current_reading(c, current), memory[SENSOR]
    lines_end = LINES + plant.act_whole + 2
    for k in range(LINES, lines_end):
        memory[k] = u
    for k in range(lines_end, lines_end + 2 * (plant.sense_whole + 1), 2):
        memory[k], memory[k + 1] = memory[I_READ], memory[X_READ]


@kernel
def hold(plant: Packed, memory: NDArray[np.float64], u: float) -> None:
    """Advance the rig by one tick under u_c = u, V; `memory` (see the top of the file) is updated in place."""
    p = PlantNumbers(*plant)
    T_s = p.sample_time_s
    # Most models have no delay: nothing has to be moved then.
    if p.act_whole == 0 and p.act_part_s == 0.0 and p.sense_whole == 0 and p.sense_part_s == 0.0:
        over(p.base, p.c, memory, u, 0.0, T_s, STOPS)
        memory[I_READ], memory[X_READ] = reading_of_current(p.c, memory), memory[SENSOR]
        return
    last_u = LINES + p.act_whole + 1
    # Moved, not a ring with an index: the index would be one more state of each exported model.
    for k in range(last_u, LINES, -1):
        memory[k] = memory[k - 1]
    memory[LINES] = u
    last = last_u + 1 + 2 * p.sense_whole
    for k in range(last, last_u + 1, -2):
        memory[k], memory[k + 1] = memory[k - 2], memory[k - 1]
    change, look = p.act_part_s, T_s - p.sense_part_s  # within the tick: the input changes, the sensors are looked at
    at = 0.0
    # The tick is cut where the input changes and where the sensors look, so nothing is interpolated.
    for end in (min(change, look), max(change, look), T_s):
        if end > at:
            over(p.base, p.c, memory, memory[last_u] if at < change else memory[last_u - 1], 0.0, end - at, STOPS)
            at = end
        # Exactly equal: `at` was set to one of the three ends.
        if at == look:
            memory[last_u + 1], memory[last_u + 2] = reading_of_current(p.c, memory), memory[SENSOR]
    memory[I_READ], memory[X_READ] = memory[last], memory[last + 1]
