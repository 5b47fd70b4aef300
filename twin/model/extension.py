"""Conversion of a model to the arguments of the kernels of `extended.py`.

Rule: a model without causes gives the neutral vector; `extended.py` is then the paper's (1) and (6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.extended import Base
from twin.model.parameters import Model, ModelCause


def vector(causes: Sequence[ModelCause]) -> NDArray[np.float64]:
    """The vector c of these causes, shape (PLACES,); all other causes are neutral."""
    # One vector for all causes, not a list of functions: compiled once, the kernels fly any combination.
    c = neutral()
    for cause in causes:
        for parameter in BY_NAME[cause.name].parameters:
            c[parameter.index] = cause.parameters[parameter.name].value
    return c


def base(model: Model) -> Base:
    """The paper's parameters and the plant of a model."""
    p = model.plant
    return Base(
        K_A=model.K_A,
        T_A=model.T_A,
        K_c=model.K_c,
        b=model.b,
        mass_kg=p.mass_kg,
        gravity_m_s2=p.gravity_m_s2,
        x_max_m=p.x_max_m,
        travel_m=p.travel_m,
    )


def sentences(model: Model) -> list[str]:
    """Return one line per cause: name, title, parameters."""
    lines = []
    for cause in model.causes:
        known = BY_NAME[cause.name]
        values = ", ".join(
            f"{parameter.symbol} = {cause.parameters[parameter.name].value:.4g} {parameter.unit}".rstrip()
            for parameter in known.parameters
        )
        lines.append(f"{cause.name}: {known.title} ({values})")
    return lines
