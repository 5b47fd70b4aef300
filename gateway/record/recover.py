"""Recovers the intact messages of a broken log into a clean file, and reports the losses.

Messages are copied byte for byte (never parsed and written again), in the order of the broken file.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from gateway.record.summary import Gap, SampleGaps
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.errors import DataError
from protocol.log.reader import LogReader
from protocol.log.scan import Damage


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """The result of a recovery.  Times are in seconds from the first message."""

    broken: Path
    clean: Path
    was_finished: bool  # the file had its end: nothing was cut off
    messages: int
    bytes_read: int
    damages: tuple[Damage, ...]
    messages_unidentified: int  # intact, but the description of their channel is lost
    foreign: int  # of other schemas, not copied
    last_good_s: float | None
    last_good_ns: int | None
    gaps: tuple[Gap, ...]  # in the numbering of samples, by board
    bytes_lost: int  # of the broken file: could not be read completely
    seconds_lost: float | None  # from the last saved message to the last one known to have been logged


def recover(broken: Path, clean: Path) -> Recovery:
    """Copy everything intact of `broken` into the new file `clean`.

    Raises:
        DataError: `broken` is absent, empty, not MCAP, or nothing of it can be saved.
        LogError: `clean` exists or cannot be written.
    """
    reader = LogReader(broken)
    scan = reader.scans[0]
    if not scan.indexed:
        for _ in scan.messages():  # a description that was lost may come again, behind messages that need it
            pass
    gaps: dict[str, SampleGaps] = {}
    first_ns = last_ns = None
    messages = 0
    records = reader.raw()
    first = next(records, None)  # the metadata comes before it, and is known from here on
    with LogWriter(clean, metadata={**scan.metadata, "recovered": {"from": broken.name}}) as writer:
        for record in chain([] if first is None else [first], records):
            writer.write(record.key, record.data, record.time_ns)
            messages += 1
            first_ns = record.time_ns if first_ns is None else min(first_ns, record.time_ns)
            last_ns = record.time_ns if last_ns is None else max(last_ns, record.time_ns)
            board = gaps.setdefault(record.board, SampleGaps(record.board))
            if record.topic == "state" and (state := encoding.parse(pb.State, record.data)) is not None:
                board.take(state)
            elif record.topic == "parameters" and (known := encoding.parse(pb.Parameters, record.data)) is not None:
                board.divider = max(known.stream_divider, 1)
    if not messages:
        clean.unlink()
        reasons = "; ".join(damage.reason for damage in scan.damages) or "it holds no Board51 messages"
        raise DataError(f"Nothing of {broken} can be recovered: {reasons}", remedy="Use another part of the log")
    until_ns = max((damage.until_ns or 0 for damage in scan.damages), default=0)
    return Recovery(
        broken=broken, clean=clean, was_finished=scan.finished, messages=messages, bytes_read=scan.size,
        damages=tuple(scan.damages), messages_unidentified=scan.unknown_channel, foreign=sum(reader.foreign.values()),
        last_good_s=None if last_ns is None or first_ns is None else (last_ns - first_ns) / 1e9, last_good_ns=last_ns,
        gaps=tuple(gap for board in gaps.values() for gap in board.gaps),
        bytes_lost=sum(damage.bytes for damage in scan.damages),
        seconds_lost=max(0.0, (until_ns - last_ns) / 1e9) if until_ns and last_ns is not None else None,
    )  # fmt: skip
