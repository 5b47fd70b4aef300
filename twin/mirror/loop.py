"""The free-running twin: the model under its own copy of the board's law, fed with nothing but x_ref.

Rule 1: in closed loop no measurement enters after the start: the twin does what the model says the loop does.
Rule 2: the state held is the one at the tick of the next sample: look at it, then run the tick.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.control import LawNumbers, law
from twin.simulate import PlantNumbers, tick


@kernel
def closed_loop_tick(
    plant: Packed, law_: Packed, i: float, x: float, v: float, s: float, x_prev: float, x_ref: float
) -> tuple[float, float, float, float, float]:
    """(u_c of this tick, then i_c, x, x' and the integral at the next): V, A, m, m/s, m s."""
    u, s = law(LawNumbers(*law_), i, x, x_prev, s, x_ref)
    i, x, v = tick(PlantNumbers(*plant), i, x, v, u)
    return u, i, x, v, s


@kernel
def advance(
    plant: Packed, law_: Packed, memory: NDArray[np.float64], closed_loop: bool, x_ref: float, u: float
) -> tuple[float, float, float, float]:
    """Run one tick, in closed loop under x_ref, else under the given u: A, m, m/s, V.

    memory, shape (5,): i_c, x, x', integral of (x_ref - x) dt, x at the tick before (for the law's speed).
    Returns (i_c, x, x', u_c) of the tick that was run.
    """
    i, x, v = memory[0], memory[1], memory[2]
    if closed_loop:
        u, memory[0], memory[1], memory[2], memory[3] = closed_loop_tick(
            plant, law_, i, x, v, memory[3], memory[4], x_ref
        )
    else:
        memory[0], memory[1], memory[2] = tick(PlantNumbers(*plant), i, x, v, u)
    memory[4] = x
    return i, x, v, u
