"""The model in the very experiment: its loop simulated without noise, under the recorded reference.

Its coefficients are estimated as those of the rig are.  So what the estimate adds by itself (leakage of a chirp, the
plant's gain over a finite swing) is in both, and makes no difference between rig and model.
"""

from __future__ import annotations

import numpy as np

from twin.control import LawNumbers
from twin.estimation.record import FloatArray
from twin.model.equilibrium import equilibrium
from twin.model.parameters import Model
from twin.model.simulate import INTEGRAL, X_BEFORE, plant_numbers, rig_at
from twin.validation.loop import simulate_loop

LEAD_S = 1.0  # at rest before the part


def simulated(x_ref: FloatArray, model: Model, law: LawNumbers, *, delay: int = 0) -> FloatArray | None:
    """Return x_ref, u_c, i_c and x of the model's loop, shape (4, n).

    Args:
        x_ref: reference of the part, m, shape (n,).
        model: with causes or not.
        law: of the board.
        delay: of u_c, samples, that the identification of the model corrected.

    Returns:
        None if the model's loop does not hold the ball within the travel.
    """
    T_s = law.sample_time_s
    lead = round(LEAD_S / T_s)
    driven = np.concatenate((np.full(lead, x_ref[0]), x_ref))
    i, u = equilibrium(model, float(x_ref[0]))
    if not np.isfinite(u):
        return None
    plant = plant_numbers(model, T_s)
    begin = rig_at(plant, i=i, x=float(x_ref[0]), v=0.0, u=u)
    steady = law.u_0 - law.k_i * (i - law.i_0) - law.k_x * (x_ref[0] - law.x_0)
    # The integral that holds the ball there: from 0, the loop would first have to build it up.
    begin[INTEGRAL] = (u - steady) / law.k_s if law.k_s != 0.0 else 0.0
    begin[X_BEFORE] = x_ref[0]
    out = np.empty((3, len(driven)))
    quiet, exact = np.zeros((4, len(driven))), np.zeros(3)
    simulate_loop(tuple(plant), tuple(law), driven, quiet, exact, begin, np.full(delay, u), out)
    i_c, x, u_c = out[:, lead:]
    # At a stop or a limit of u_c a loop has no response to speak of.
    touches = not np.isfinite(out).all() or x.min() <= 0.0 or x.max() >= model.plant.travel_m
    limited = u_c.min() <= law.u_low or u_c.max() >= law.u_high
    return None if touches or limited else np.stack((driven[lead:], u_c, i_c, x))
