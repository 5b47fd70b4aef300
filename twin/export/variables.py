"""The numbers of a rig that another tool sees: parameters, inputs, outputs, with unit, range and description."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from protocol.campaign import Plant
from protocol.checked import bounds, keys_of
from twin.control import LawNumbers
from twin.export.rig import simulated
from twin.model.extended import I_C, V, X
from twin.model.parameters import PARAMETERS, Model
from twin.model.simulate import I_READ, X_READ

Role = Literal["parameter", "fixed", "input", "output"]  # fixed: a parameter that stays once the simulation has begun


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A number that the rig takes or gives."""

    name: str
    field: str  # in the record of all numbers, as C writes it
    role: Role
    unit: str = ""
    description: str
    start: float = 0.0  # of an output: not used
    low: float = -math.inf
    high: float = math.inf


_OF_PAPER = {
    "K_A": "gain of the amplifier (1)",
    "T_A": "time constant of the amplifier (1)",
    "K_c": "force constant of (3)",
    "b": "linear drag of (5)",
}
_OF_PLANT = {
    "mass_kg": ("mass", "kg", "mass of the ball"),
    "gravity_m_s2": ("gravity", "m/s^2", "acceleration of gravity"),
    "x_max_m": ("x_max", "m", "x_max of (3)"),
    "travel_m": ("travel", "m", "highest position of the ball, at the top stop"),
}
_OF_LAW = {
    "u_0": ("V", "input at the operating point (13)"),
    "i_0": ("A", "reading of the current at the operating point (13)"),
    "x_0": ("m", "reading of the position at the operating point (13)"),
    "k_i": ("V/A", "gain of i_c - i_0"),
    "k_x": ("V/m", "gain of x - x_0"),
    "k_p": ("V/m", "gain of x_ref - x"),
    "k_v": ("V s/m", "gain of the speed, a backward difference"),
    "k_s": ("V/(m s)", "gain of the integral of x_ref - x"),
    "u_low": ("V", "lower end of the range of u_c"),
    "u_high": ("V", "upper end of the range of u_c"),
    "s_max": ("m s", "largest integral of x_ref - x"),
}


def title(model: Model) -> str:
    """The title of an export.  The name is a stranger's text: what could end a comment or a string is replaced."""
    return f"Magnetic levitation: {re.sub(r'[^A-Za-z0-9 .,+_-]', '_', model.plant.name)}"


def variables(model: Model, law: LawNumbers) -> list[Variable]:
    """All numbers of a rig, in a fixed order: inputs, outputs, parameters."""
    return [*inputs(law), *outputs(), *parameters(model), *of_law(law), *starts(law)]


def inputs(law: LawNumbers) -> list[Variable]:
    """The inputs of the rig: u_c in open loop, x_ref in closed loop."""
    return [
        Variable(name="u_c", field="u_c", role="input", unit="V", description="input in open loop", start=law.u_0),
        Variable(
            name="x_ref", field="x_ref", role="input", unit="m", description="reference in closed loop", start=law.x_0
        ),
    ]


def outputs() -> list[Variable]:
    """The state of the rig, its readings, and u_c."""

    def output(name: str, field: str, unit: str, description: str) -> Variable:
        return Variable(name=name, field=field, role="output", unit=unit, description=description)

    return [
        output("i", f"memory[{I_C}]", "A", "current of the coil"),
        output("x", f"memory[{X}]", "m", "position of the ball, up from the bottom stop"),
        output("v", f"memory[{V}]", "m/s", "speed of the ball, upwards"),
        output("y_i", f"memory[{I_READ}]", "A", "reading of the current sensor"),
        output("y_x", f"memory[{X_READ}]", "m", "reading of the position sensor"),
        output("u", "u", "V", "u_c in force during the tick that ended last"),
    ]


def parameters(model: Model) -> list[Variable]:
    """The parameters of (1) and (6), the plant, and the causes of the model."""
    plant_bounds = {name: bounds(hint) for name, hint in keys_of(Plant).items() if name in _OF_PLANT}
    listed = [
        Variable(
            name=name,
            field=name,
            role="parameter",
            unit=unit,
            description=f"{_OF_PAPER[name]}; {model.parameters[name].verdict}",
            start=model.parameters[name].value,
            low=low,
            high=high,
        )
        for name, (unit, low, high) in PARAMETERS.items()
    ]
    for field, (name, unit, description) in _OF_PLANT.items():
        low, high = plant_bounds[field]
        listed.append(
            Variable(
                name=name,
                field=field,
                role="parameter",
                unit=unit,
                description=description,
                start=getattr(model.plant, field),
                low=-math.inf if low is None else low,
                high=math.inf if high is None else high,
            )
        )
    values = {cause.name: cause.parameters for cause in model.causes}
    for cause, one in simulated(model):
        listed.append(
            Variable(
                name=f"{cause.name.replace('-', '_')}.{one.name}",
                field=f"c[{one.index}]",
                role="fixed" if "delays" in cause.traits else "parameter",
                unit=one.unit,
                description=f"{cause.title}: {one.symbol} of {cause.equation}",
                start=values[cause.name][one.name].value,
                low=one.low,
                high=one.high,
            )
        )
    return listed


def of_law(law: LawNumbers) -> list[Variable]:
    """The parameters of the control law."""
    return [
        Variable(
            name=f"law.{name}",
            field=name,
            role="parameter",
            unit=unit,
            description=description,
            start=min(getattr(law, name), 1e300),  # a law without a converter has no largest integral
        )
        for name, (unit, description) in _OF_LAW.items()
    ]


def starts(law: LawNumbers) -> list[Variable]:
    """The state of the rig when the simulation begins."""

    def start(name: str, unit: str, value: float, description: str) -> Variable:
        return Variable(
            name=f"start.{name}", field=f"{name}_start", role="fixed", unit=unit, description=description, start=value
        )

    return [
        start("i", "A", law.i_0, "reading of the current at the beginning, held for a long time"),
        start("x", "m", law.x_0, "reading of the position at the beginning"),
        start("v", "m/s", 0.0, "speed at the beginning"),
        start("u", "V", law.u_0, "input before the beginning"),
    ]
