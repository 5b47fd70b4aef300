"""investigation.json in the campaign's folder: each step with reason and result, so that a run can be continued.

Rule: after each step it is written to a temporary file, synced and renamed.  The content of the campaign's own lists is
      not repeated.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from gateway.campaign.folder import Folder
from gateway.investigate.decide import Finish, Known
from protocol.checked import Flag, Number, RuleError, Whole, checked, key
from protocol.diagnosis import Diagnosis, read_diagnosis
from protocol.errors import DataError, UsageError
from protocol.files import make_folder, parse_json, read_small, replace_text, writing

FILE = "investigation.json"
FORMAT = 1
_REMEDY = "Give a new folder, or delete that file: the recordings are kept and diagnosed again"
_REFUSED = ("given-up", "impossible", "skipped")


@dataclass(slots=True, kw_only=True)
class Performed:
    """A step of experiments."""

    why: str
    standings: dict[str, str]  # by experiment, of `campaign run`
    rig_s: Number  # time on the rig


@dataclass(slots=True, kw_only=True)
class Diagnosed:
    """A diagnosis."""

    why: str
    thorough: Flag
    recordings: list[str]
    found: dict[str, Any]  # the part of diagnosis.json for `read_diagnosis`


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    performed: Performed | None = None
    diagnosed: Diagnosed | None = None

    def __post_init__(self) -> None:
        if (self.performed is None) == (self.diagnosed is None):
            raise RuleError(" is not one of performed | diagnosed", remedy=_REMEDY)


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    format: Annotated[Whole, key("format of the file", FORMAT, FORMAT)]
    board: str
    steps: tuple[_Step, ...]


@dataclass(slots=True, kw_only=True)
class Journal:
    """The steps in a folder."""

    folder: Path
    board: str
    steps: list[Performed | Diagnosed] = field(default_factory=list)
    ended: Finish | None = None

    @property
    def rig_s(self) -> float:
        """Time on the rig so far, s."""
        return sum(step.rig_s for step in self.steps if isinstance(step, Performed))

    @property
    def diagnosed(self) -> Diagnosed | None:
        """The newest diagnosis."""
        return next((step for step in reversed(self.steps) if isinstance(step, Diagnosed)), None)

    def answer(self) -> Diagnosis | None:
        """The answer of the newest diagnosis.  Raises DataError if it is damaged."""
        newest = self.diagnosed
        return None if newest is None else read_diagnosis(newest.found, where=str(self.folder / FILE), remedy=_REMEDY)

    def known(self, *, budget_s: float, quick: bool) -> Known:
        """The state of the investigation; arguments as of `investigate`.

        Raises:
            UsageError, DataError: the folder has another campaign, or is damaged.
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
            recordings=frozenset(Folder(self.folder).retained),
            refused=frozenset(refused),
            answer=self.answer(),
            diagnosed=frozenset(newest.recordings if newest else ()),
            thorough=newest is not None and newest.thorough,
            left_s=budget_s - self.rig_s,
            quick=quick,
        )

    def to_json(self) -> dict[str, Any]:
        """Content of the file."""
        return {
            "format": FORMAT,
            "board": self.board,
            "rig_s": self.rig_s,
            "steps": [{type(step).__name__.lower(): asdict(step)} for step in self.steps],
            "ended": None if self.ended is None else asdict(self.ended),
        }

    def save(self) -> None:
        """Write the file.  Raises UsageError if that is not possible."""
        make_folder(self.folder)
        with writing(self.folder / FILE):
            replace_text(self.folder / FILE, json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")


def open_journal(folder: Path, board: str) -> Journal:
    """Read the journal of a folder, or begin a new one.

    Raises:
        UsageError: it is of another board.
        DataError: it is damaged.
    """
    path = folder / FILE
    if not path.exists():
        return Journal(folder=folder, board=board)
    table = parse_json(read_small(path, remedy=_REMEDY), where=str(path), remedy=_REMEDY)
    file: _File = checked(_File, table, where=str(path), error=DataError, remedy=_REMEDY)
    steps = [step for entry in file.steps for step in (entry.performed, entry.diagnosed) if step is not None]
    journal = Journal(folder=folder, board=file.board, steps=steps)
    if journal.board != board:
        raise UsageError(f"{folder} is an investigation of {journal.board}, not of {board}", remedy="Give a new --out")
    journal.answer()  # raises for a damaged answer before the ball moves
    return journal
