"""What of a diagnosis decides about the next experiment.  Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocol.errors import DataError


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspect:
    """One name of the answer, with those that the recordings cannot tell from it."""

    name: str
    confidence: float
    confounders: Mapping[str, float]  # by name: separation so far, standard errors
    experiments: Mapping[str, Mapping[str, float]]  # by name: by confounder, separation with that experiment added
    outside: tuple[str, ...] = ()  # what to measure beside the board where no experiment separates


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a diagnosis says."""

    verdict: str  # of diagnosis.json
    sentence: str
    suspects: tuple[Suspect, ...] = ()  # causes; where none holds, candidates

    @property
    def is_open(self) -> bool:
        """Whether a name of it may be another's."""
        return any(suspect.confounders for suspect in self.suspects)


def read_answer(data: Mapping[str, Any], *, where: str) -> Answer:
    """The answer in a diagnosis.json.

    Args:
        data: what the file holds.
        where: its path, for the error.

    Raises:
        DataError: it is no such file.
    """
    try:
        suspects = tuple(_suspect(one) for one in data["causes"] or data["candidates"])
        return Answer(verdict=str(data["verdict"]), sentence=str(data["sentence"]), suspects=suspects)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{where} is no answer of board51 diagnose ({error!r})", remedy="Delete it") from None


def _suspect(data: Mapping[str, Any]) -> Suspect:
    proposal = data.get("next_experiment") or {}
    now = proposal.get("separation_z_now", {})
    return Suspect(
        name=str(data["name"]),
        confidence=float(data["confidence"]),
        confounders={str(confounder): _z(now.get(confounder)) for confounder in data["indistinguishable_from"]},
        experiments={
            str(one["name"]): {str(confounder): _z(z) for confounder, z in one["separation_z"].items()}
            for one in proposal.get("experiments", ())
        },
        outside=tuple(map(str, proposal.get("not_separable_here", ()))),
    )


def _z(value: object) -> float:
    """0 where nothing is known; what no confounder survives is null in JSON."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
