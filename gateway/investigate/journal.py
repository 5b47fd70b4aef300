"""investigation.json in the campaign's folder: each step, why, and what came of it, so that an end is not the end.

Rule: it is written after each step, beside its place, synced and renamed; what is in the campaign's own lists is not
      repeated here.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gateway.campaign.folder import Folder
from gateway.investigate.answer import Answer, read_answer
from gateway.investigate.decide import Finish, Known
from protocol.errors import DataError, UsageError
from protocol.files import make_folder, parse_json, read_small, writing

FILE = "investigation.json"
FORMAT = 1
_REMEDY = "Give a new folder, or delete that file: the recordings are kept and the diagnosis is made anew"
_REFUSED = ("given-up", "impossible", "skipped")


@dataclass(slots=True, kw_only=True)
class Performed:
    """Experiments that were made, or not."""

    why: str
    standings: dict[str, str]  # by experiment, as `campaign run` says it
    rig_s: float  # time on the rig


@dataclass(slots=True, kw_only=True)
class Diagnosed:
    """A diagnosis of what was there."""

    why: str
    thorough: bool
    recordings: list[str]
    found: dict[str, Any]  # of diagnosis.json, what `read_answer` needs


@dataclass(slots=True, kw_only=True)
class Journal:
    """What was done in a folder."""

    folder: Path
    board: str
    steps: list[Performed | Diagnosed] = field(default_factory=list)
    ended: Finish | None = None

    @property
    def rig_s(self) -> float:
        """Time on the rig so far."""
        return sum(step.rig_s for step in self.steps if isinstance(step, Performed))

    @property
    def diagnosed(self) -> Diagnosed | None:
        """The newest."""
        return next((step for step in reversed(self.steps) if isinstance(step, Diagnosed)), None)

    def answer(self) -> Answer | None:
        """Of the newest diagnosis.  Raises DataError where the file is damaged."""
        newest = self.diagnosed
        return None if newest is None else read_answer(newest.found, where=str(self.folder / FILE))

    def known(self, *, budget_s: float, quick: bool) -> Known:
        """Where it stands.

        Raises:
            UsageError, DataError: the folder is another's, or damaged.
        """
        newest = self.diagnosed
        refused = {
            name
            for step in self.steps
            if isinstance(step, Performed)
            for name, standing in step.standings.items()
            if standing in _REFUSED
        }
        return Known(
            there=frozenset(Folder(self.folder).retained),
            refused=frozenset(refused),
            answer=self.answer(),
            asked_of=frozenset(newest.recordings if newest else ()),
            thorough=newest is not None and newest.thorough,
            left_s=budget_s - self.rig_s,
            quick=quick,
        )

    def to_json(self) -> dict[str, Any]:
        """The file."""
        return {
            "format": FORMAT,
            "board": self.board,
            "rig_s": self.rig_s,
            "steps": [{type(step).__name__.lower(): asdict(step)} for step in self.steps],
            "ended": None if self.ended is None else asdict(self.ended),
        }

    def save(self) -> None:
        """Bring the file up to date.  Raises UsageError where it cannot be written."""
        make_folder(self.folder)
        beside = self.folder / f".{FILE}.part"
        with writing(self.folder / FILE):
            with beside.open("w", encoding="utf-8") as file:
                file.write(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")
                file.flush()
                os.fsync(file.fileno())
            beside.replace(self.folder / FILE)


def open_journal(folder: Path, board: str) -> Journal:
    """That of the folder, or a new one.

    Raises:
        UsageError: it is of another board.
        DataError: it is damaged.
    """
    path = folder / FILE
    if not path.exists():
        return Journal(folder=folder, board=board)
    table = parse_json(read_small(path, remedy=_REMEDY), where=str(path), remedy=_REMEDY)
    try:
        if table["format"] != FORMAT:
            raise DataError(f"{path} has format {table['format']}, this is {FORMAT}", remedy=_REMEDY)
        journal = Journal(folder=folder, board=str(table["board"]), steps=[_step(one) for one in table["steps"]])
    except (KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{path} cannot be read ({error!r})", remedy=_REMEDY) from None
    if journal.board != board:
        raise UsageError(f"{folder} is an investigation of {journal.board}, not of {board}", remedy="Give a new --out")
    journal.answer()  # damaged is said before anything moves
    return journal


def _step(table: Mapping[str, Any]) -> Performed | Diagnosed:
    if "performed" in table:
        return Performed(**table["performed"])
    return Diagnosed(**table["diagnosed"])
