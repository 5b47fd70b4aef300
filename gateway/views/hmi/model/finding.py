"""The part of a diagnosis.json that a page shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.errors import DataError
from protocol.experiments import EXPERIMENT_OF_NAME
from protocol.files import parse_json, read_small

_REMEDY = "Diagnose the campaign again"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ahead:
    """The prediction error on the judge recordings at one horizon, rms in m; (value, low, high) where it is known."""

    horizon_s: float
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    noise_floor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingCause:
    """A cause or candidate."""

    name: str
    sentence: str
    confidence: float
    equals: tuple[str, ...]  # causes that the recordings cannot tell from it
    confirm: str  # how to see it at the rig
    cure: str
    experiments: tuple[str, ...]  # of the campaign's menu, that tell them apart, the best first
    outside: tuple[str, ...]  # measurements with other instruments


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The answer of a diagnosis."""

    verdict: str
    sentence: str
    calibrated: bool
    plant_assumed: bool  # nobody stated the plant of the rig
    sure: bool  # whether `causes` are causes, and not candidates
    causes: tuple[FindingCause, ...]
    ahead: tuple[Ahead, ...]
    warnings: tuple[str, ...]


def read_finding(path: Path) -> Finding:
    """Read diagnosis.json.

    Raises:
        DataError: it cannot be read, or is not the answer of a diagnosis.
    """
    table = parse_json(read_small(path, remedy=_REMEDY), where=str(path))
    try:
        causes = table.get("causes") or table.get("candidates") or []
        show = table.get("show") or {}
        return Finding(
            verdict=str(table["verdict"]),
            sentence=str(table["sentence"]),
            calibrated=bool(table.get("calibrated", True)),
            plant_assumed=table.get("plant_assumed") is True,
            sure=bool(table.get("causes")),
            causes=tuple(map(_cause, causes)),
            ahead=tuple(_ahead(entry) for entry in show.get("ahead", ())) if show.get("judged") else (),
            warnings=tuple(map(str, table.get("warnings", ()))),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path} is not a diagnosis.json of board51 diagnose ({error!r})", remedy=_REMEDY) from None


def _cause(table: Mapping[str, Any]) -> FindingCause:
    proposal = table.get("next_experiment") or {}
    rig = table.get("at_the_rig") or {}
    return FindingCause(
        name=str(table["name"]),
        sentence=str(table.get("sentence", table["name"])),
        confidence=float(table["confidence"]),
        equals=tuple(map(str, table.get("indistinguishable_from", ()))),
        confirm=str(rig.get("confirm", "")),
        cure=str(rig.get("cure", "")),
        experiments=tuple(
            n for n in (str(entry["name"]) for entry in proposal.get("experiments", ())) if n in EXPERIMENT_OF_NAME
        ),
        outside=tuple(map(str, proposal.get("not_separable_here", ()))),
    )


def _ahead(table: Mapping[str, Any]) -> Ahead:
    return Ahead(
        horizon_s=float(table["horizon_s"]),
        before=_interval(table["baseline"]),
        after=_interval(table["extended"]),
        noise_floor=float(table["floor_m"]),
    )


def _interval(table: Mapping[str, Any]) -> tuple[float, float, float]:
    value = float(table["value"])
    low, high = (value if table.get(end) is None else float(table[end]) for end in ("low", "high"))
    return value, low, high
