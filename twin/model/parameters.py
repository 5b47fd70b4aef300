"""Model files: read, check, write.  `board51 identify` writes this format and every twin command reads it.

Rule 1: reading is strict.  A missing key, another unit, a number that is not finite or not physical is an error that
        names the key.  With a guessed parameter the twin would report its own error as one of the rig.
Rule 2: units are always the ones below; nothing is converted.
Rule 3: each entry of `causes` is in the catalogue and has all its parameters, in their units and physical ranges.
        Only shape parameters may be left out; they are then those of the usual form.  An empty list is the paper's
        model.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import date
from functools import partial
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator

from protocol.campaign import Plant
from protocol.checked import KEYS, Number, RuleError, bounds, checked, key, keys_of, needs
from protocol.errors import DataError
from protocol.files import parse_json, read_small, writing
from protocol.plant import refuse_impossible

SHIPPED = ("ce152", "inteco", "magnetoshield")  # models that come with the product, by name
Verdict = Literal["identified", "weak", "not-identifiable", "assumed"]  # assumed: from a source, not from a recording

# name: (unit, lowest, highest).  The bounds hold for any laboratory rig of this kind; they reveal a wrong unit or a
# wrong power of ten.
PARAMETERS: dict[str, tuple[str, float, float]] = {
    "K_A": ("A/V", 1e-3, 100.0),
    "T_A": ("s", 1e-7, 1.0),
    "K_c": ("N m^2/A^2", 1e-9, 1e-1),
    "b": ("N s/m", 0.0, 10.0),
}
MAX_NAME = 64  # characters of a name: it goes into logs and onto terminals
NAME_REMEDY = f"Use at most {MAX_NAME} characters, all of them printable"
MAX_LISTED = 3  # causes in the name of a model
REMEDY = "Give a model.json as `identify` writes it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A parameter: value, unit, uncertainty, verdict and origin."""

    __pydantic_config__ = KEYS

    value: Number
    unit: str
    std: Annotated[Number, key("standard deviation, in the unit", 0.0)] | None = None  # None: unknown
    ci95: tuple[Number, Number] | None = None
    verdict: Verdict = "assumed"
    method: str = ""
    equation: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Standard deviations of white noise per sample.  Quantisation (lsb^2 / 12) is added from the board's scalings."""

    __pydantic_config__ = KEYS

    sigma_x_m: Annotated[Number, key("noise of x, m", 1e-9, 1e-2)]
    sigma_i_c_a: Annotated[Number, key("noise of i_c, A", 1e-7, 1.0)]
    # Constant over a tick: the only process noise of (6).
    process_a_m_s2: Annotated[Number, key("acceleration that the model does not explain, m/s^2", 0.0, 10.0)]
    process_i_c_a: Annotated[Number, key("the same for the current of (1), A", 0.0, 1.0)]


NOISE: dict[str, Any] = {name: bounds(hint) for name, hint in keys_of(Noise).items()}
_SUPPLIED = BeforeValidator(needs("verdict", "method", "equation"))
_Parameters = Mapping[str, Annotated[Parameter, _SUPPLIED]]


def _all_fit(
    supplied: Mapping[str, Parameter],
    known: Mapping[str, tuple[str, float, float]],
    usual: Mapping[str, Parameter] = MappingProxyType({}),
) -> Mapping[str, Parameter]:
    """Check names, units and ranges; returns the parameters in the order of `known`.

    Args:
        supplied: parameters of the file.
        known: unit, lowest and highest value of each.
        usual: parameters that a file may leave out.

    Raises:
        RuleError: a parameter is missing, unknown, in another unit or out of range.
    """
    supplied = {**usual, **supplied}
    for name in (*known, *supplied):
        if name not in supplied or name not in known:
            problem = " is missing" if name in known else " is not a parameter"
            raise RuleError(problem, remedy=f"They are {', '.join(known)}", key=name)
        (unit, low, high), parameter = known[name], supplied[name]
        if parameter.unit != unit:
            problem = f".unit = {parameter.unit!r} is not {unit!r}"
            raise RuleError(problem, remedy=f"Convert the value to {unit!r}", key=name)
        if not low <= parameter.value <= high:
            problem = f".value = {parameter.value:g} is not in {low:g} .. {high:g}"
            raise RuleError(problem, remedy="Check the unit and the power of ten", key=name)
    # In one order: equal models have equal text, however their files were laid out.
    return {name: supplied[name] for name in known}


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelCause:
    """A cause that the model includes, with its parameters."""

    __pydantic_config__ = KEYS

    name: str  # of twin/model/causes/catalogue.py
    parameters: _Parameters


def _in_catalogue(cause: ModelCause) -> ModelCause:
    # Imported here because the catalogue loads compiled kernels, which most models do not need.
    from twin.model.causes.catalogue import BY_NAME

    usable = [known.name for known in BY_NAME.values() if known.detector != "stated"]
    if cause.name not in usable:
        raise RuleError(" is not in the catalogue", remedy=f"Use one of {', '.join(usable)}")
    known = {
        parameter.name: (parameter.unit, parameter.low, parameter.high) for parameter in BY_NAME[cause.name].parameters
    }
    try:
        return ModelCause(name=cause.name, parameters=_all_fit(cause.parameters, known, _usual(cause.name)))
    except RuleError as error:
        raise RuleError(f".parameters{error.problem}", remedy=error.remedy) from None


def _usual(cause: str) -> Mapping[str, Parameter]:
    """The shape parameters of a cause in its usual form, for older files, which do not have them."""
    from twin.model.causes.catalogue import BY_NAME

    known = BY_NAME[cause]
    return {
        parameter.name: Parameter(
            value=parameter.neutral, unit=parameter.unit, method="usual form", equation=known.equation
        )
        for parameter in known.shapes
    }


def _each_once(causes: tuple[ModelCause, ...]) -> tuple[ModelCause, ...]:
    for n, cause in enumerate(causes):
        if any(cause.name == other.name for other in causes[:n]):
            raise RuleError(f" {n + 1} ({cause.name}) appears twice", remedy="Name each cause once")
    return causes


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A model: plant, parameters of (1) and (6), causes that extend them, noise, provenance."""

    __pydantic_config__ = KEYS

    plant: Annotated[Plant, BeforeValidator(refuse_impossible)]
    parameters: Annotated[_Parameters, AfterValidator(partial(_all_fit, known=PARAMETERS))]
    # In order of decreasing importance.
    causes: Annotated[tuple[Annotated[ModelCause, AfterValidator(_in_catalogue)], ...], AfterValidator(_each_once)] = ()
    noise: Noise
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file, or a shipped model by its name: "ce152", "inteco", "magnetoshield".

        Raises:
            DataError: the file is missing, is not JSON or is not a valid model; the message names key and value.
        """
        if isinstance(path, str) and path in SHIPPED:
            path = str(files("twin.model").joinpath(f"{path}.json"))
        return parse_model(read_small(Path(path), remedy="Give the path of a model.json"), where=str(path))

    def to_json(self) -> dict[str, Any]:
        """The content of the model file."""
        content: dict[str, Any] = json.loads(model_text(self))
        return content

    def save(self, path: str | Path) -> None:
        """Write a model file, as `board51 identify --out` does.

        Raises:
            UsageError: the file cannot be written.
        """
        with writing(Path(path)):
            Path(path).write_text(model_text(self) + "\n", encoding="utf-8")

    @property
    def measured(self) -> date | None:
        """Return the day on which its recordings were made, UTC; None where the model file does not state it."""
        try:
            return date.fromisoformat(str(self.provenance.get("measured", "")))
        except ValueError:
            return None

    @property
    def name(self) -> str:
        """Return the name that a person chose, else plant, causes and day: "ce152 + air-gap-offset, 24 Nov 2026"."""
        chosen = self.provenance.get("name")
        if isinstance(chosen, str) and chosen and not name_problem(chosen):  # it goes onto terminals
            return chosen
        causes = [cause.name for cause in self.causes]
        if len(causes) > MAX_LISTED:
            causes[MAX_LISTED - 1 :] = [f"{len(causes) - MAX_LISTED + 1} more"]
        parts, day = " + ".join((self.plant.name, *causes)), self.measured
        return parts if day is None else f"{parts}, {day.day} {day:%b %Y}"

    @property
    def K_A(self) -> float:
        """Return the gain of the amplifier (1), A/V."""
        return self.parameters["K_A"].value

    @property
    def T_A(self) -> float:
        """Return the time constant of the amplifier (1), s."""
        return self.parameters["T_A"].value

    @property
    def K_c(self) -> float:
        """Return the force constant of (3), N m^2/A^2."""
        return self.parameters["K_c"].value

    @property
    def b(self) -> float:
        """Return the linear drag of (5), N s/m."""
        return self.parameters["b"].value


_COMPLETE = Annotated[Model, BeforeValidator(needs("causes", "provenance"))]


def name_problem(name: str) -> str:
    """Return what is wrong with a name for people, after the name of its key; empty if nothing is."""
    if len(name) <= MAX_NAME and name.isprintable():
        return ""
    return f"is {name[:MAX_NAME]!r}, {len(name)} characters"


def verdict_by(half_width: float, value: float) -> Verdict:
    """The verdict on a parameter by half the width of its 95 % interval."""
    return "identified" if half_width < 0.25 * value else "weak" if half_width < value else "not-identifiable"


def parse_model(text: str, *, where: str) -> Model:
    """Parse a model from JSON text; `where` names the source in errors.  Raises DataError."""
    return model_from_dict(parse_json(text, where=where, remedy=REMEDY), where=where)


def model_text(model: Model) -> str:
    """The JSON text of a model file; `parse_model` is the inverse.  Raises ValueError for NaN."""
    content = asdict(model)
    if model.plant.ball_diameter_m is None:
        del content["plant"]["ball_diameter_m"]  # so that older models keep their text
    return json.dumps(content, indent=2, allow_nan=False)


def model_from_dict(data: object, *, where: str) -> Model:
    """Check parsed JSON key by key and build the model; `where` names the source in errors.  Raises DataError."""
    model: Model = checked(_COMPLETE, data, where=where, error=DataError)
    return model
