"""The part of a diagnosis that determines the next experiment.  Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocol.errors import DataError


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspect:
    """A cause of the answer, with the causes that the recordings cannot distinguish from it."""

    name: str
    confidence: float
    confounders: Mapping[str, float]  # by name: separation so far, standard errors
    experiments: Mapping[str, Mapping[str, float]]  # by experiment and confounder: separation with it added
    outside: tuple[str, ...] = ()  # measurements with other instruments, for those that no experiment separates


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The result of a diagnosis."""

    verdict: str  # of diagnosis.json
    sentence: str
    suspects: tuple[Suspect, ...] = ()  # the causes; without any, the candidates

    @property
    def is_open(self) -> bool:
        """Return whether a cause has confounders."""
        return any(suspect.confounders for suspect in self.suspects)


def read_answer(data: Mapping[str, Any], *, where: str) -> Answer:
    """Read the answer from a diagnosis.json.

    Args:
        data: parsed content of the file.
        where: its path, for errors.

    Raises:
        DataError: it is not a diagnosis.json.
    """
    try:
        suspects = tuple(_suspect(entry) for entry in data["causes"] or data["candidates"])
        return Answer(verdict=str(data["verdict"]), sentence=str(data["sentence"]), suspects=suspects)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(
            f"{where} is not a diagnosis.json of board51 diagnose ({error!r})", remedy="Delete it"
        ) from None


def _suspect(data: Mapping[str, Any]) -> Suspect:
    proposal = data.get("next_experiment") or {}
    now = proposal.get("separation_z_now", {})
    return Suspect(
        name=str(data["name"]),
        confidence=float(data["confidence"]),
        confounders={str(confounder): _z(now.get(confounder)) for confounder in data["indistinguishable_from"]},
        experiments={
            str(entry["name"]): {str(confounder): _z(z) for confounder, z in entry["separation_z"].items()}
            for entry in proposal.get("experiments", ())
        },
        outside=tuple(map(str, proposal.get("not_separable_here", ()))),
    )


def _z(value: object) -> float:
    """A separation; 0 if it is missing or null."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
