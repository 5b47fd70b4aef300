"""The record of who did what with a campaign: `acts.jsonl` in its folder, one line for each act."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

FILE = "acts.jsonl"
MAX_ACTS = 20
_TAIL_BYTES = 65_536  # of the end of the file that is read


@dataclass(frozen=True, slots=True, kw_only=True)
class Act:
    """An act: one line of the file."""

    at: str  # for people
    who: str
    what: str


def write_act(folder: Path, *, who: str, what: str) -> None:
    """Append a line.  Raises OSError where the folder cannot be written."""
    folder.mkdir(parents=True, exist_ok=True)
    line = json.dumps({"at": time.strftime("%Y-%m-%d %H:%M"), "who": who, "what": what})
    with (folder / FILE).open("a", encoding="utf-8") as stream:
        stream.write(line + "\n")


def acts_of(folder: Path) -> tuple[Act, ...]:
    """The newest acts, in their order; lines that are none are left out."""
    try:
        with (folder / FILE).open("rb") as stream:
            stream.seek(max(0, stream.seek(0, 2) - _TAIL_BYTES))
            lines = stream.read().decode("utf-8", errors="replace").splitlines()
    except OSError:
        return ()
    return tuple(act for act in map(_act, lines[-MAX_ACTS:]) if act is not None)


def _act(line: str) -> Act | None:
    try:
        table = json.loads(line)
        return Act(at=str(table["at"]), who=str(table["who"]), what=str(table["what"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
