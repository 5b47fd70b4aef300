"""A model file: read, checked, written.  The format is what `board51 identify` gives and every twin command takes.

Rule 1: strict.  A missing key, another unit, a number that is not finite or not physical is refused by name: a twin
        that runs on a guessed parameter accuses the rig of its own mistake.
Rule 2: units are the ones below, always; there is no conversion.
Rule 3: `causes` are of the catalogue, each with all its parameters, in its unit and within its physical
        range: a half-known cause is none; [] is the paper's model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

from protocol import campaign
from protocol.files import parse_json, read_small, writing
from twin.model.causes.cause import CauseParameter
from twin.model.checks import finite, number, refuse, table

SHIPPED = ("ce152", "inteco")  # models that come with the product, by name
VERDICTS = ("identified", "weak", "not-identifiable", "assumed")  # assumed: taken from a source, not from a record

# name: (unit, lowest, highest).  The bounds are of any laboratory rig of this kind, not of one: they catch a wrong
# unit or a slipped power of ten.
PARAMETERS: dict[str, tuple[str, float, float]] = {
    "K_A": ("A/V", 1e-3, 100.0),
    "T_A": ("s", 1e-7, 1.0),
    "K_c": ("N m^2/A^2", 1e-9, 1e-1),
    "b": ("N s/m", 0.0, 10.0),
}
PLANT: dict[str, tuple[float, float]] = {key: (low, high) for key, (low, high, _) in campaign.PLANT_BOUNDS.items()}
NOISE: dict[str, tuple[float, float]] = {
    "sigma_x_m": (1e-9, 1e-2),
    "sigma_i_c_a": (1e-7, 1.0),
    "process_a_m_s2": (0.0, 10.0),
    "process_i_c_a": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One estimated number with its standing."""

    value: float
    unit: str
    std: float | None = None  # None: nobody measured it
    ci95: tuple[float, float] | None = None
    verdict: str = "assumed"
    method: str = ""
    equation: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """Known without identification; x is up from the bottom stop."""

    name: str
    mass_kg: float
    travel_m: float  # top stop
    x_max_m: float  # x_max of (3)
    gravity_m_s2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """White, per sample.  Converter quantisation (lsb^2 / 12) comes on top, from the board's own scalings."""

    sigma_x_m: float
    sigma_i_c_a: float
    process_a_m_s2: (
        float  # acceleration the model does not explain, constant over a tick: the observer's only doubt in (6)
    )
    process_i_c_a: float  # the same for (1)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelCause:
    """One effect of the catalogue that the model includes, with its size."""

    name: str  # of twin/model/causes/catalogue.py
    parameters: Mapping[str, Parameter]


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Plant, parameters of (1) and (6), the causes that extend them, noise, provenance."""

    plant: Plant
    parameters: Mapping[str, Parameter]
    noise: Noise
    causes: tuple[ModelCause, ...] = ()  # in the order of their importance
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file, or a shipped model by its name: "ce152", "inteco".

        Raises:
            DataError: no such file, or not a model.
        """
        shipped = isinstance(path, str) and path in SHIPPED
        return load_model(str(files("twin.model").joinpath(f"{path}.json")) if shipped else path)

    def to_json(self) -> dict[str, Any]:
        """What a model file holds."""
        return model_to_dict(self)

    def save(self, path: str | Path) -> None:
        """Write a model file, as `board51 identify --out` does.

        Raises:
            UsageError: it cannot be written.
        """
        text = json.dumps(self.to_json(), indent=2, allow_nan=False) + "\n"
        with writing(Path(path)):
            Path(path).write_text(text, encoding="utf-8")

    @property
    def K_A(self) -> float:
        """Gain of the amplifier (1), A/V."""
        return self.parameters["K_A"].value

    @property
    def T_A(self) -> float:
        """Time constant of the amplifier (1), s."""
        return self.parameters["T_A"].value

    @property
    def K_c(self) -> float:
        """Force constant of (3), N m^2/A^2."""
        return self.parameters["K_c"].value

    @property
    def b(self) -> float:
        """Linear drag of (5), N s/m."""
        return self.parameters["b"].value


def plant_of(model: Model) -> campaign.Plant:
    """The constants of the model as the estimators take them."""
    p = model.plant
    return campaign.Plant(
        name=p.name, mass_kg=p.mass_kg, travel_m=p.travel_m, x_max_m=p.x_max_m, gravity_m_s2=p.gravity_m_s2
    )


def load_model(path: str | Path) -> Model:
    """Read a model file.

    Raises:
        DataError: no such file, not JSON, or not a model; names the key and the value.
    """
    where = str(path)
    text = read_small(Path(path), remedy="Give the path of a model.json")
    data = parse_json(text, where=where, remedy="Give a model.json as `identify` writes it")
    return model_from_dict(data, where=where)


def model_from_dict(data: object, *, where: str) -> Model:
    """Check `data` (the parsed JSON) key by key; `where` names its source in errors.  Raises DataError."""
    top = table(data, where, "the model", ("plant", "parameters", "causes", "noise", "provenance"))
    plant = table(top["plant"], where, "plant", ("name", *PLANT))
    if not isinstance(plant["name"], str) or not plant["name"]:
        refuse(where, f"plant.name is {plant['name']!r}", "Write the rig's name as text")
    constants = {key: number(plant[key], where, f"plant.{key}", *bounds) for key, bounds in PLANT.items()}
    if constants["x_max_m"] < constants["travel_m"]:
        refuse(
            where,
            f"plant.x_max_m = {constants['x_max_m']:g} is below plant.travel_m = {constants['travel_m']:g}",
            "The force (3) is infinite at x_max: it must not lie within the travel",
        )
    entries = table(top["parameters"], where, "parameters", tuple(PARAMETERS))
    noise = table(top["noise"], where, "noise", tuple(NOISE))
    causes: tuple[ModelCause, ...] = ()
    if top["causes"] != []:
        causes = _causes_from(top["causes"], where=where)
    return Model(
        plant=Plant(name=plant["name"], **constants),
        parameters={
            key: parameter_from(entries[key], where, f"parameters.{key}", *PARAMETERS[key]) for key in PARAMETERS
        },
        causes=causes,
        noise=Noise(**{key: number(noise[key], where, f"noise.{key}", *bounds) for key, bounds in NOISE.items()}),
        provenance=table(top["provenance"], where, "provenance", ()),
    )


def _causes_from(data: object, *, where: str) -> tuple[ModelCause, ...]:
    """The causes of a model file, from their JSON form; `where` names the file in errors.

    Raises:
        DataError: not a list, a cause or a parameter that the catalogue does not have, one that lacks, a wrong unit,
            a value out of its physical range.
    """
    # Only here: the catalogue is made of kernels, and most models need none of them.
    from twin.model.causes.catalogue import BY_NAME

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
        causes.append(_cause(name, BY_NAME[name].parameters, entry["parameters"], where, f"{key} ({name})"))
    return tuple(causes)


def _cause(name: str, known: Sequence[CauseParameter], data: object, where: str, key: str) -> ModelCause:
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


def model_to_dict(model: Model) -> dict[str, Any]:
    """The JSON form; `model_from_dict` of it gives the model back."""
    return {
        "plant": {"name": model.plant.name} | {key: getattr(model.plant, key) for key in PLANT},
        "parameters": _entries(model.parameters),
        "causes": [{"name": cause.name, "parameters": _entries(cause.parameters)} for cause in model.causes],
        "noise": {key: getattr(model.noise, key) for key in NOISE},
        "provenance": dict(model.provenance),
    }


def parameter_from(data: object, where: str, key: str, unit: str, lowest: float, highest: float) -> Parameter:
    """Check one parameter, in its unit and within its bounds; `key` names it in errors.  Raises DataError."""
    entry = table(data, where, key, ("value", "unit", "verdict", "method", "equation"))
    if entry["unit"] != unit:
        refuse(where, f"{key}.unit is {entry['unit']!r}", f"The unit is {unit!r}; convert the value to it")
    if entry["verdict"] not in VERDICTS:
        refuse(where, f"{key}.verdict is {entry['verdict']!r}", f"Use one of {', '.join(VERDICTS)}")
    std = entry.get("std")
    ci95 = entry.get("ci95")
    if ci95 is not None and (not isinstance(ci95, list) or len(ci95) != 2):
        refuse(where, f"{key}.ci95 is {ci95!r}", "Write [low, high], or null where nobody measured it")
    return Parameter(
        value=number(entry["value"], where, f"{key}.value", lowest, highest),
        unit=unit,
        std=None if std is None else number(std, where, f"{key}.std", 0.0, math.inf),
        ci95=None if ci95 is None else (finite(ci95[0], where, f"{key}.ci95"), finite(ci95[1], where, f"{key}.ci95")),
        verdict=entry["verdict"],
        method=str(entry["method"]),
        equation=str(entry["equation"]),
    )


def _entries(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    return {
        key: {
            "value": p.value,
            "unit": p.unit,
            "std": p.std,
            "ci95": list(p.ci95) if p.ci95 else None,
            "verdict": p.verdict,
            "method": p.method,
            "equation": p.equation,
        }
        for key, p in parameters.items()
    }
