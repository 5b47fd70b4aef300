"""The causes of a model: read and checked against the catalogue, and as the kernels of `extended.py` take them.

Rule 1: every parameter of a cause is given, in its unit and within its physical range: a half-known cause is none.
Rule 2: a model without causes gives the neutral vector, with which `extended.py` is the paper's (1) and (6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.checks import refuse, table
from twin.model.extended import Base
from twin.model.parameters import Model, ModelCause, parameter_from


def causes_from(data: object, *, where: str) -> tuple[ModelCause, ...]:
    """The causes of a model file, from their JSON form; `where` names the file in errors.

    Raises:
        DataError: not a list, a cause or a parameter that the catalogue does not have, one that lacks, a wrong unit,
            a value out of its physical range.
    """
    if not isinstance(data, list):
        refuse(where, "causes is not a list", "Write [] for the paper's model")
    causes: list[ModelCause] = []
    for n, entry in enumerate(data):
        key = f"causes[{n}]"
        name = table(entry, where, key, ("name", "parameters"))["name"]
        if not isinstance(name, str) or name not in BY_NAME:
            refuse(where, f"{key} is {name!r}, not in the catalogue", f"Use one of {', '.join(BY_NAME)}")
        if any(cause.name == name for cause in causes):
            refuse(where, f"{key} is {name}, which is there already", "Name each cause once")
        causes.append(_cause(name, entry["parameters"], where, f"{key} ({name})"))
    return tuple(causes)


def _cause(name: str, data: object, where: str, key: str) -> ModelCause:
    known = BY_NAME[name].parameters
    entries = table(data, where, f"{key}.parameters", tuple(parameter.name for parameter in known))
    for parameter in entries:
        if parameter not in [one.name for one in known]:
            listed = ", ".join(one.name for one in known)
            refuse(where, f"{key} has no parameter {parameter!r}", f"It has {listed}")
    return ModelCause(
        name=name,
        parameters={
            one.name: parameter_from(
                entries[one.name], where, f"{key}.parameters.{one.name}", one.unit, one.low, one.high
            )
            for one in known
        },
    )


def vector(causes: Sequence[ModelCause]) -> NDArray[np.float64]:
    """The vector c of these causes, shape (PLACES,); all others neutral."""
    c = neutral()
    for cause in causes:
        for parameter in BY_NAME[cause.name].parameters:
            c[parameter.place] = cause.parameters[parameter.name].value
    return c


def base(model: Model) -> Base:
    """The paper's parameters of a model, as the kernels of `extended.py` take them."""
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
    """One line per cause: its name, what it is, its numbers."""
    lines = []
    for cause in model.causes:
        known = BY_NAME[cause.name]
        values = ", ".join(
            f"{one.symbol} = {cause.parameters[one.name].value:.4g} {one.unit}".rstrip() for one in known.parameters
        )
        lines.append(f"{cause.name}: {known.title} ({values})")
    return lines
