"""The linear model of an exported rig about its operating point, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.errors import UsageError
from twin.control import discrete, linearise
from twin.control_design.gains import without_lags
from twin.estimation.record import FloatArray
from twin.export.controller import Controller
from twin.model.linear import delay_s
from twin.model.parameters import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """(14) and (15); the first three states are the readings of i_c and x and the speed, in A, m, m/s."""

    A: FloatArray  # of the model without delays, shape (n, n)
    B: FloatArray  # shape (n, 1)
    delay_s: float  # from u_c to the readings
    Phi: FloatArray  # with delays as further states
    Gamma: FloatArray
    Phi_prompt: FloatArray  # without what no channel measures, shape (3, 3): the plant of (18)
    Gamma_prompt: FloatArray


def linear(model: Model, controller: Controller) -> Linear:
    """Linearise and discretise a model about the operating point of its controller.

    Raises:
        UsageError: the model has no equilibrium there.
    """
    x, T_s = controller.point.x_m, controller.sample_time_s
    A, B = linearise(model, x)
    if not np.isfinite(A).all():
        raise UsageError(
            f"the model has no equilibrium at x = {x:g} m, the operating point of the controller",
            remedy="Give a controller that was designed for this model",
        )
    whole = discrete(model, x, T_s)
    prompt = discrete(without_lags(model), x, T_s)
    return Linear(
        A=A,
        B=B,
        delay_s=delay_s(model) if model.causes else 0.0,
        Phi=whole[0],
        Gamma=whole[1],
        Phi_prompt=prompt[0],
        Gamma_prompt=prompt[1],
    )
