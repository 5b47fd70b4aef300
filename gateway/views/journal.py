"""The journal of what became of the alarms of one board: came, went, acknowledged, shelved, by whom.  Pure.

Rule 1: memory is bounded; the oldest entry goes first.
Rule 2: `count` rises with each entry, so that a view knows without a look whether there are new ones.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

MAX_ENTRIES = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A line of the journal."""

    at_ns: int  # Unix time
    name: str  # of the alarm
    what: str  # "came" | "went" | "acknowledged" | "shelved" | "unshelved"
    severity: str
    who: str = ""  # a person; empty where nobody did it
    until_ns: int = 0  # of a shelving
    text: str = ""


class Journal:
    """The newest entries of one board."""

    def __init__(self) -> None:
        self.count = 0
        self._entries: deque[Entry] = deque(maxlen=MAX_ENTRIES)

    def note(self, entry: Entry) -> None:
        """Add an entry."""
        self.count += 1
        self._entries.append(entry)

    def newest_first(self) -> tuple[Entry, ...]:
        """Return the entries."""
        return tuple(reversed(self._entries))
