"""Reads the local recording for the time that is compared; parts of other times are released.

Parts that are finished say in their index from when to when they are, the others are read.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from gateway.record.blocks import BlockId, pack
from gateway.record.contents import Contents
from protocol.errors import DataError
from protocol.log.scan import Scan

MARGIN_NS = 600 * 10**9  # more than a block is long, and than messages of one time come apart


class LocalLog:
    """The parts of a folder, also those that are being written."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._contents: dict[Path, Contents] = {}
        self._extents: dict[Path, tuple[int, int]] = {}  # first and last log time of finished parts

    def look(self, first_ns: int, last_ns: int) -> None:
        """Read what is new in the parts that may hold records of this time."""
        overlapping = [path for path in sorted(self._folder.glob("*.mcap")) if self._overlaps(path, first_ns, last_ns)]
        self._contents = {path: self._contents[path] for path in overlapping if path in self._contents}
        for path in overlapping:
            with contextlib.suppress(DataError):  # not a log (yet), or deleted meanwhile
                self._contents.setdefault(path, self._contents.get(path) or Contents(path)).refresh()

    def ids(self, block: BlockId) -> set[int]:
        """Return the ids of a block in all these parts."""
        return set().union(*(contents.ids(block) for contents in self._contents.values()))

    def digest(self, block: BlockId) -> int:
        """Return the digest of a block; 0 if no part has it."""
        entries = [entry for contents in self._contents.values() if (entry := contents.blocks.get(block)) is not None]
        if len(entries) == 1:
            return entries[0].digest
        return pack(self.ids(block))[1] if entries else 0

    def _overlaps(self, path: Path, first_ns: int, last_ns: int) -> bool:
        extent = self._extents.get(path)
        if extent is None:
            with contextlib.suppress(DataError):
                scan = Scan(path)
                if scan.indexed and scan.first_ns is not None and scan.last_ns is not None:
                    extent = self._extents[path] = (scan.first_ns, scan.last_ns)
        return extent is None or (extent[0] - MARGIN_NS <= last_ns and first_ns <= extent[1] + MARGIN_NS)
