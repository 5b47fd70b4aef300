"""Copies a log and adds the topics of Foxglove's Log and 3D panels (`derived`)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from gateway.record.writer import LogWriter
from gateway.views.foxglove.derived import TOPICS, Derived
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.log.reader import LogReader


def write_with_panels(logs: Path | Sequence[Path], out: Path) -> int:
    """Write the messages of a log as they are, each followed by what is derived from it.

    Returns:
        Number of derived messages.

    Raises:
        DataError: the log is absent, damaged, or holds no Board51 messages.
        LogError: `out` exists or cannot be written.
    """
    reader = LogReader(logs)
    derived, count, last_ns = Derived(), 0, None
    records = reader.raw()
    first = next(records, None)  # the metadata comes before it, and is known from here on
    with LogWriter(out, metadata={**reader.metadata, "foxglove": {"from": reader.name}}) as writer:
        for record in chain([] if first is None else [first], records):
            last_ns = record.time_ns
            writer.write(record.key, record.data, last_ns)
            message = parse(topics.TOPIC_OF_NAME[record.topic].message, record.data) if record.topic in TOPICS else None
            for key, panel in derived.take(record.site, record.board, message, last_ns) if message is not None else ():
                writer.write(key, panel.encode(), last_ns, schema=panel.get_schema)
                count += 1
        reader.check(last_ns=last_ns)
    return count
