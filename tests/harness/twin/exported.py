"""Models with causes to export, and the twin's own simulation of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from twin.control import LawNumbers
from twin.control_design.design import Specification, design
from twin.estimation.record import FloatArray
from twin.export import controller
from twin.mirror.loop import advance
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.curve import COEFFICIENTS
from twin.model.extended import I_C, V, X
from twin.model.parameters import Model, ModelCause, Parameter
from twin.model.simulate import I_READ, X_BEFORE, X_READ, plant_numbers, rig_at

T_S = 2e-3
OUTPUTS = ("i", "x", "v", "y_i", "y_x", "u")


def with_causes(*names: str, sizes: dict[str, float] | None = None) -> Model:
    """The shipped CE 152 with these causes, of medium size and in their usual form; `sizes`: by cause or parameter."""
    model = Model.load("ce152")
    causes = []
    for name in names:
        cause = BY_NAME[name]
        values = {
            item.name: item.neutral if math.isfinite(item.spread) else item.probes[(len(item.probes) - 1) // 2]
            for item in cause.parameters
        }
        values[cause.strength.name] = (sizes or {}).get(name, values[cause.strength.name])
        values |= {item: size for item in values if (size := (sizes or {}).get(f"{name}.{item}")) is not None}
        causes.append(
            ModelCause(
                name=name,
                parameters={item.name: Parameter(value=values[item.name], unit=item.unit) for item in cause.parameters},
            )
        )
    return dataclasses.replace(model, causes=tuple(causes))


def with_curve(name: str, low: float, high: float) -> Model:
    """The shipped CE 152 with a curve over low .. high."""
    cause = BY_NAME[name]
    ends = {cause.parameters[0].name: low, cause.parameters[1].name: high}
    values = ends | {f"k_{j}": 0.05 * (-1.0) ** j * j / COEFFICIENTS for j in range(1, COEFFICIENTS + 1)}
    parameters = {item.name: Parameter(value=values[item.name], unit=item.unit) for item in cause.parameters}
    return dataclasses.replace(Model.load("ce152"), causes=(ModelCause(name=name, parameters=parameters),))


def law_for(model: Model) -> LawNumbers:
    return controller.of_design(design(model, Specification(sample_time_s=T_S)), u_max_v=5.0).numbers


def steps(law: LawNumbers, seconds: float) -> FloatArray:
    """References: a step of 0.5 mm up or down every 0.2 s."""
    n = round(seconds / law.sample_time_s)
    signs = np.random.default_rng(4).choice([-1.0, 1.0], n // 100 + 1)
    return np.asarray(law.x_0 + 0.5e-3 * np.repeat(signs, 100)[:n])


def pushes(law: LawNumbers, seconds: float) -> FloatArray:
    """Inputs that throw the ball from stop to stop."""
    n = round(seconds / law.sample_time_s)
    return np.asarray(law.u_0 * np.where(np.arange(n) % 500 < 250, 1.4, 0.6))


def twin_flight(model: Model, law: LawNumbers, drive: FloatArray, *, closed_loop: bool) -> FloatArray:
    """The free twin under references or inputs from rest at the operating point: `OUTPUTS` after each tick."""
    plant = plant_numbers(model, law.sample_time_s)
    memory = rig_at(plant, i=law.i_0, x=law.x_0, v=0.0, u=law.u_0)
    memory[X_BEFORE] = memory[X_READ]
    flight = np.empty((len(drive), len(OUTPUTS)))
    for k, value in enumerate(drive):
        _, _, _, u = advance(tuple(plant), tuple(law), memory, closed_loop, value, value)
        flight[k] = memory[I_C], memory[X], memory[V], memory[I_READ], memory[X_READ], u
    return flight
