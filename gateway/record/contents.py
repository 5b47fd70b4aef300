"""The blocks of one part of a log; of a growing part, only new blocks are read.

Memory: about 300 bytes for each block, so 30 kB for an hour of one board without a twin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gateway.record.blocks import BlockId, locate, pack, unpack
from protocol.bus.topics import RECORDED
from protocol.log.reader import LogReader, RawLogRecord


@dataclass(frozen=True, slots=True)
class Entry:
    """The records of a block in one part."""

    ids: bytes  # packed
    digest: int
    count: int
    last_ns: int  # log time of the newest
    begin_byte: int  # of the part: where the first is
    end_byte: int  # where the newest is


class _Fresh:
    """The records of a block that this pass has read."""

    def __init__(self, block: BlockId, begin_byte: int) -> None:
        self.block, self.ids, self.last_ns, self.end_byte = block, set[int](), 0, begin_byte


class Contents:
    """The blocks of one part, finished or not.

    Raises:
        DataError: the file is absent, empty or not MCAP.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.blocks: dict[BlockId, Entry] = {}
        self.damage = ""  # what could not be read; empty: nothing
        self._reader = LogReader(path)
        self._scan = self._reader.scans[0]
        self._read_bytes = self._next_byte = 0

    def refresh(self, limit_s: float = math.inf) -> bool:
        """Read what has been written since, for `limit_s` at most; return whether that was all.

        Raises:
            DataError: the file is gone.
        """
        self._scan.grow()
        if self._scan.size == self._read_bytes:
            return True
        end_s, complete = time.monotonic() + limit_s, True
        fresh: dict[str, _Fresh] = {}  # of each stream the block that is being read
        # A part that was not read to its end is continued where that pass ended: ids are sets.
        for record in self._reader.raw(topics_=RECORDED, from_byte=self._next_byte):
            if time.monotonic() > end_s and self._scan.offset > self._next_byte:
                complete = False
                break
            located = locate(record)
            if located is None:
                continue
            block, offset = located.block, self._scan.offset
            known = fresh.get(block.stream)
            if known is None or known.block != block:
                if known is not None:
                    self._merge(known)
                self.blocks.setdefault(block, Entry(b"", 0, 0, 0, offset, offset))  # in the order of the part
                known = fresh[block.stream] = _Fresh(block, offset)
            known.ids.add(located.id)
            known.last_ns, known.end_byte = max(known.last_ns, record.time_ns), offset
        for known in fresh.values():
            self._merge(known)
        self._next_byte = self._scan.offset
        if complete:
            self._read_bytes = self._scan.size
        lost = [damage for damage in self._scan.damages if not damage.is_cut]
        if lost:
            self.damage = (
                f"{self.path.name} is damaged at byte {lost[0].offset}: {lost[0].reason};"
                f" {sum(damage.bytes for damage in lost)} bytes cannot be read"
            )
        return complete

    def ids(self, block: BlockId) -> set[int]:
        """Return the ids of a block; empty if it is not here."""
        entry = self.blocks.get(block)
        return set() if entry is None else unpack(entry.ids)

    def records(self, block: BlockId) -> Iterator[tuple[int, RawLogRecord]]:
        """Yield id and record of each record of a block, once, with the log time that a recorder at another site gives.

        That is its own time.  What bears none has the newest time of its board before it (`client/recording.py`).
        """
        missing, entry = self.ids(block), self.blocks.get(block)
        _, board, *topic = block.stream.split("/", 2)
        newest_ns = 0
        waiting: list[tuple[int, RawLogRecord]] = []  # without a time, before the first that bears one
        begin = 0 if entry is None else entry.begin_byte
        names = [*topic, "state"] if topic else RECORDED
        for record in self._reader.raw(topics_=names, boards=[board], from_byte=begin):
            if not missing and not waiting:
                return
            located = locate(record)
            if located is None:
                continue
            if located.stamp_ns is not None:
                newest_ns = max(newest_ns, located.stamp_ns)
                yield from ((number, early._replace(time_ns=newest_ns)) for number, early in waiting)
                waiting.clear()
            if located.block != block or located.id not in missing:
                continue
            missing.discard(located.id)
            if located.stamp_ns is None and not newest_ns:
                waiting.append((located.id, record))
            else:
                yield located.id, record._replace(time_ns=located.stamp_ns or newest_ns)
        yield from waiting

    def _merge(self, fresh: _Fresh) -> None:
        known = self.blocks[fresh.block]
        ids = fresh.ids | unpack(known.ids)
        packed, digest = pack(ids)
        last_ns, end_byte = max(fresh.last_ns, known.last_ns), max(fresh.end_byte, known.end_byte)
        self.blocks[fresh.block] = Entry(packed, digest, len(ids), last_ns, known.begin_byte, end_byte)
