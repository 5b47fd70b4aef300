"""The free-running twin: the model under its own copy of the board's law, driven by x_ref alone.

Rule 1: in closed loop no measurement enters after the start: the twin does what the model says the loop does.
Rule 2: the state held is the one at the tick of the next sample: look at it, then run the tick.
Rule 3: the law uses the readings of the model's sensors, and these are compared with the readings of the rig.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.control import LawNumbers, law
from twin.model.extended import V
from twin.model.simulate import I_READ, INTEGRAL, X_BEFORE, X_READ, hold


@kernel
def run_law(law_: Packed, memory: NDArray[np.float64], i: float, x: float, x_ref: float) -> float:
    """Return u_c, V, for readings i (A) and x (m), and advance the law's part of the memory."""
    u, memory[INTEGRAL] = law(LawNumbers(*law_), i, x, memory[X_BEFORE], memory[INTEGRAL], x_ref)
    memory[X_BEFORE] = x
    return u


@kernel
def advance(
    plant: Packed, law_: Packed, memory: NDArray[np.float64], closed_loop: bool, x_ref: float, u: float
) -> tuple[float, float, float, float]:
    """Run one tick, in closed loop under x_ref, else under the given u: A, m, m/s, V.

    memory: of a rig (`twin/model/simulate.py`), the integral of (x_ref - x) dt and x at the tick before in it.
    Returns (i_c, x as the sensors show them, x', u_c) of the tick that was run.
    """
    i, x, v = memory[I_READ], memory[X_READ], memory[V]
    if closed_loop:
        u = run_law(law_, memory, i, x, x_ref)
    # In open loop, too: when the loop is closed, the law differences against the reading before.
    memory[X_BEFORE] = x
    hold(plant, memory, u)
    return i, x, v, u
