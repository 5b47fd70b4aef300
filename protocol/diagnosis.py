"""The answer of a diagnosis: the part of diagnosis.json that programs other than the twin read.

board51 diagnose -> diagnosis.json -> read_diagnosis -> page of the model, investigation, demo
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.errors import DataError
from protocol.experiments import EXPERIMENT_OF_NAME
from protocol.files import parse_json, read_small

_REMEDY = "Diagnose the campaign again"
Interval = tuple[float, float, float]  # value and its limits; both are the value where no limits are known


@dataclass(frozen=True, slots=True, kw_only=True)
class Ahead:
    """The prediction error on the judge recordings at one horizon, rms in m."""

    horizon_s: float
    before: Interval
    after: Interval
    noise_floor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A cause or candidate, with the causes that the recordings cannot distinguish from it."""

    name: str
    sentence: str = ""
    confidence: float
    confounders: Mapping[str, float]  # by name: separation so far, standard errors
    experiments: Mapping[str, Mapping[str, float]]  # of the menu, the best first: separation from each confounder
    outside: tuple[str, ...] = ()  # measurements with other instruments
    confirm: str = ""  # how to see it at the rig
    cure: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """The answer of a diagnosis."""

    verdict: str
    sentence: str
    headline: str = ""  # the same in at most two short sentences
    causes: tuple[Cause, ...] = ()
    candidates: tuple[Cause, ...] = ()
    calibrated: bool = True
    plant_assumed: bool = False  # nobody stated the plant of the rig
    model_offered: bool = False  # a twin gains by the extended model
    ahead: tuple[Ahead, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def suspects(self) -> tuple[Cause, ...]:
        """The causes; without any, the candidates."""
        return self.causes or self.candidates

    @property
    def is_open(self) -> bool:
        """Return whether a suspect has confounders."""
        return any(suspect.confounders for suspect in self.suspects)


def load_diagnosis(path: Path) -> Diagnosis:
    """Read a diagnosis.json.

    Raises:
        DataError: It cannot be read, or is not the answer of a diagnosis.
    """
    return read_diagnosis(parse_json(read_small(path, remedy=_REMEDY), where=str(path)), where=str(path))


def read_diagnosis(table: Mapping[str, Any], *, where: str, remedy: str = _REMEDY) -> Diagnosis:
    """Read the answer from the parsed content of diagnosis.json.

    Raises:
        DataError: It is not a diagnosis.json.
    """
    try:
        show = table.get("show") or {}
        return Diagnosis(
            verdict=str(table["verdict"]),
            headline=str(table.get("headline", table["sentence"])),
            sentence=str(table["sentence"]),
            causes=tuple(map(_cause, table.get("causes", ()))),
            candidates=tuple(map(_cause, table.get("candidates", ()))),
            calibrated=bool(table.get("calibrated", True)),
            plant_assumed=table.get("plant_assumed") is True,
            model_offered=(table.get("extended_model") or {}).get("offered") is True,
            ahead=tuple(map(_ahead, show.get("ahead", ()))) if show.get("judged") else (),
            warnings=tuple(map(str, table.get("warnings", ()))),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{where} is not a diagnosis.json of board51 diagnose ({error!r})", remedy=remedy) from None


def _cause(table: Mapping[str, Any]) -> Cause:
    proposal, rig = table.get("next_experiment") or {}, table.get("at_the_rig") or {}
    now = proposal.get("separation_z_now", {})
    # No experiment separates a wrong stated value from a cause, so it is a measurement in `outside`.
    stated = {entry["name"]: entry for entry in table.get("alternatives", ()) if entry.get("stated")}
    return Cause(
        name=str(table["name"]),
        sentence=str(table.get("sentence", table["name"])),
        confidence=_number(table, "confidence"),
        confounders={str(name): _z(now.get(name)) for name in table["indistinguishable_from"] if name not in stated},
        experiments={
            str(entry["name"]): {str(name): _z(z) for name, z in entry["separation_z"].items()}
            for entry in proposal.get("experiments", ())
            if entry["name"] in EXPERIMENT_OF_NAME
        },
        outside=(
            *map(str, proposal.get("not_separable_here", ())),
            *(f"{entry['sentence']}? {entry['confirm']}" for entry in stated.values()),
        ),
        confirm=str(rig.get("confirm", "")),
        cure=str(rig.get("cure", "")),
    )


def _z(value: object) -> float:
    """A separation; 0 if it is missing or null."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0


def _number(table: Mapping[str, Any], key: str) -> float:
    value = float(table[key])
    if not math.isfinite(value):
        raise ValueError(f"{key} = {value}")
    return value


def _ahead(table: Mapping[str, Any]) -> Ahead:
    return Ahead(
        horizon_s=_number(table, "horizon_s"),
        before=_interval(table["baseline"]),
        after=_interval(table["extended"]),
        noise_floor=_number(table, "floor_m"),
    )


def _interval(table: Mapping[str, Any]) -> Interval:
    value = _number(table, "value")
    low, high = (value if table.get(end) is None else _number(table, end) for end in ("low", "high"))
    return value, low, high
