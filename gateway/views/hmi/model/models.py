"""The models that may be given to the twin of a rig, and which of them it runs on.

    DATA/campaigns/<campaign>/model.json                          identified
    DATA/campaigns/<campaign>/diagnosis/extended_model.json       extended by a diagnosis
    DATA/models/<board>/<date>-<time>.json                        the twin had it until a hand-over from a page

Rule: the model that a hand-over replaces is kept, so that every hand-over can be taken back.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.views.hmi.model.campaigns import EXTENDED_MODEL, MODEL, CampaignFolder, parse_table, read_table
from gateway.views.hmi.texts import text_of, texts_of
from protocol.bus import board51_pb2 as pb

MAX_REPLACED = 10  # the newest
_REPLACED = "kept"
_RESTS_ON_THE_PLANT = ("K_c", "b")


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFile:
    """A model file."""

    name: str  # of the file, for requests
    path: Path
    kind: str  # in words
    made: str  # for people
    content: dict[str, Any]  # of the JSON
    in_use: bool

    @property
    def was_replaced(self) -> bool:
        """Return whether a hand-over replaced this model."""
        return self.name.startswith(f"{_REPLACED}/")

    @property
    def plant_assumed(self) -> bool:
        """Return whether nobody stated the plant of its rig."""
        return plant_assumed(self.content)

    @property
    def summary(self) -> str:
        """Return parameters and causes in one line."""
        return summary(self.content)


def parameter_rows(content: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return name, value with unit, 95 % interval and verdict in words of each parameter of a model file."""
    table, rows = content.get("parameters"), []
    for name, entry in table.items() if isinstance(table, dict) else ():
        try:
            value, (low, high) = float(entry["value"]), map(float, entry["ci95"])
            digits = min(max(3, 2 + math.ceil(math.log10(abs(value) / (high - low)))), 7)  # as the interval knows it
            between = text_of("parameters.between", low=f"{low:#.{digits}g}", high=f"{high:#.{digits}g}")
            words = texts_of("parameter_verdict").get(entry["verdict"], str(entry["verdict"]))
            rows.append((str(name), f"{value:#.{digits}g} {entry['unit']}", between, words))
        except (KeyError, TypeError, ValueError, ZeroDivisionError):  # a model of another program: its line is enough
            continue
    return rows


def summary(content: dict[str, Any]) -> str:
    """Return the parameters (SI units) and causes of a model file in one line.

    Parameters that depend on an assumed plant are marked.
    """
    words, assumed = [], plant_assumed(content)
    parameters, causes = content.get("parameters"), content.get("causes")
    for name, parameter in parameters.items() if isinstance(parameters, dict) else ():
        value = parameter.get("value") if isinstance(parameter, dict) else parameter
        if isinstance(value, int | float):
            word = f"{name} {value:.4g}"
            rests = assumed and name in _RESTS_ON_THE_PLANT
            words.append(text_of("models.assumed_value", parameter=word) if rests else word)
    tables = [cause for cause in causes if isinstance(cause, dict)] if isinstance(causes, list) else []
    names = ", ".join(str(cause["name"]) for cause in tables if "name" in cause)
    text = ", ".join(words)
    return text_of("models.with_causes", parameters=text, causes=names) if names else text


def plant_assumed(content: dict[str, Any]) -> bool:
    """Return whether nobody stated the plant of the rig of a model file."""
    plant = content.get("plant")
    return isinstance(plant, dict) and plant.get("assumed") is True


def models_of(data: Path, board: str, campaigns: list[CampaignFolder], running: pb.TwinModel | None) -> list[ModelFile]:
    """Return the models of one board, the newest first; a file that cannot be read is left out."""
    now = parse_table(running.model_json, where="the twin's model") if running is not None else {}
    return [
        ModelFile(name=name, path=path, kind=kind, made=made, content=content, in_use=content == now)
        for name, path, kind, made in _files(data, board, campaigns)
        if (content := read_table(path)) and not _is_reference(content)
    ]


def _is_reference(content: dict[str, Any]) -> bool:
    """Return whether an extended model is the reference itself: no model of the diagnosis predicts better."""
    provenance = content.get("provenance")
    return isinstance(provenance, dict) and provenance.get("extends") == "reference" and not content.get("causes")


def keep(data: Path, running: pb.TwinModel, board: str) -> Path:
    """Write the model that the twin runs on, which is about to be replaced.  Raises OSError."""
    folder = data / "models" / board
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{time.strftime('%Y%m%d-%H%M%S')}.json"
    path.write_text(running.model_json, encoding="utf-8")
    return path


def _files(data: Path, board: str, campaigns: list[CampaignFolder]) -> Iterator[tuple[str, Path, str, str]]:
    for campaign in campaigns:
        for path, kind in (
            (campaign.file(EXTENDED_MODEL), text_of("models.extended", date=campaign.made)),
            (campaign.file(MODEL), text_of("models.identified", date=campaign.made)),
        ):
            if path is not None:
                yield f"{campaign.name}/{path.name}", path, kind, _changed(path)
    replaced = sorted((data / "models" / board).glob("*.json"), reverse=True)[:MAX_REPLACED]
    for path in replaced:
        if path.is_file() and not path.is_symlink():
            yield f"{_REPLACED}/{path.name}", path, text_of("models.replaced"), _changed(path)


def _changed(path: Path) -> str:
    try:
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(path.stat().st_mtime))
    except OSError:
        return ""
