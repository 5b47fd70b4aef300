"""The timeline of a log: where it begins, how long it is, of which rigs, and its events and alarms as marks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.errors import DataError
from protocol.log.reader import LogReader, LogRecord
from protocol.log.scan import Scan

MAX_MARKS = 300
_TEXT = 160  # characters of a mark


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """The rigs and times of a log, as its index says."""

    boards: tuple[str, ...]
    start_s: float  # Unix time
    duration_s: float


def extent(path: Path) -> Extent | None:
    """Return the extent of a log without a pass; None if it has no index (it is being written, or is damaged)."""
    try:
        scan = Scan(path)
    except DataError:
        return None
    if not scan.indexed or scan.first_ns is None or scan.last_ns is None:
        return None
    boards = {parts[1] for channel in scan.channels.values() if (parts := topics.split(channel.topic)) is not None}
    duration_s = (scan.last_ns - scan.first_ns) / 1e9
    return Extent(boards=tuple(sorted(boards)), start_s=scan.first_ns / 1e9, duration_s=duration_s)


def timeline(path: Path) -> dict[str, Any]:
    """Return start_s (Unix time), duration_s and marks of a log, as plain data for JSON.

    If there are more than MAX_MARKS, the marks of severity info are left out, then the latest ones.

    Raises:
        DataError: the log is absent, empty, not MCAP, or holds no Board51 messages.
    """
    reader = LogReader(path)
    last_ns = reader.start_ns
    marks: list[dict[str, Any]] = []
    for record in reader.records():
        last_ns = max(last_ns, record.time_ns)
        marks += _marks(record, reader.start_ns)
    reader.check_damage(last_ns=last_ns, cut_is_damage=False)
    if len(marks) > MAX_MARKS:
        marks = [mark for mark in marks if mark["severity"] != "info"] or marks
    duration_s = (last_ns - reader.start_ns) / 1e9
    return {"start_s": reader.start_ns / 1e9, "duration_s": duration_s, "marks": marks[:MAX_MARKS]}


def _marks(record: LogRecord, start_ns: int) -> Iterator[dict[str, Any]]:
    match record.message:
        case pb.Event() as event:
            severity, name, text = event.severity, event.name, event.text
        case pb.Alarm(active=True) as alarm:
            severity, name, text = "warning", alarm.name, alarm.text
        case _:
            return
    at_s = round((record.time_ns - start_ns) / 1e9, 3)
    yield {"at_s": at_s, "board": record.board, "severity": severity, "name": name, "text": text[:_TEXT]}
