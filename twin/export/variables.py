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
_OUTPUTS = {
    "i": (f"memory[{I_C}]", "A", "current of the coil"),
    "x": (f"memory[{X}]", "m", "position of the ball, up from the bottom stop"),
    "v": (f"memory[{V}]", "m/s", "speed of the ball, upwards"),
    "y_i": (f"memory[{I_READ}]", "A", "reading of the current sensor"),
    "y_x": (f"memory[{X_READ}]", "m", "reading of the position sensor"),
    "u": ("u", "V", "u_c in force during the tick that ended last"),
}


def title(model: Model) -> str:
    """The title of an export.  The name is a stranger's text: what could end a comment or a string is replaced."""
    return f"Magnetic levitation: {re.sub(r'[^A-Za-z0-9 .,+_-]', '_', model.plant.name)}"


def variables(model: Model, law: LawNumbers) -> list[Variable]:
    """All numbers of a rig, in a fixed order: inputs, outputs, parameters, and the state at the beginning."""
    inputs = {
        "u_c": ("V", law.u_0, "input in open loop"),
        "x_ref": ("m", law.x_0, "reference in closed loop"),
    }
    starts = {
        "i": ("A", law.i_0, "reading of the current at the beginning, held for a long time"),
        "x": ("m", law.x_0, "reading of the position at the beginning"),
        "v": ("m/s", 0.0, "speed at the beginning"),
        "u": ("V", law.u_0, "input before the beginning"),
    }
    return [
        *(
            Variable(name=name, field=name, role="input", unit=unit, description=text, start=value)
            for name, (unit, value, text) in inputs.items()
        ),
        *(
            Variable(name=name, field=field, role="output", unit=unit, description=text)
            for name, (field, unit, text) in _OUTPUTS.items()
        ),
        *parameters(model),
        *of_law(law),
        *(
            Variable(
                name=f"start.{name}", field=f"{name}_start", role="fixed", unit=unit, description=text, start=value
            )
            for name, (unit, value, text) in starts.items()
        ),
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
