"""Reads the records of a log that consists of any number of parts, finished or not.

Rule 1: a part without its end (the recorder still runs, or was killed) is read to its last whole chunk without an
        error.  For damage, everything intact is delivered first.  Then a DataError says how far that was and points to
        `board51 recover`.
Rule 2: messages with a foreign schema or topic are skipped and counted; a log without Board51 messages is an error.
Rule 3: records come in the order of the file, which is the order of arrival.  A model therefore gets the same input
        from a log as live.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from google.protobuf.message import Message as ProtobufMessage

from protocol.bus import encoding, topics
from protocol.errors import DataError
from protocol.log.scan import McapChannel, Scan


class LogRecord(NamedTuple):
    """A parsed message of the log."""

    key: str  # <site>/<board>/<topic>
    site: str
    board: str
    topic: str  # of protocol.bus.topics
    message: ProtobufMessage
    time_ns: int  # when it was logged, Unix time; imported recordings count from 0


class RawLogRecord(NamedTuple):
    """An unparsed message of the log."""

    key: str
    site: str
    board: str
    topic: str
    data: bytes
    time_ns: int


class LogReader:
    """A log, opened for reading: an MCAP file, or the parts of one.

    `foreign` (skipped messages, by topic), `unparsable` and the damages of the scans are complete after one pass.

    Raises:
        DataError: a file is absent, empty or not MCAP.
    """

    def __init__(self, paths: Path | Sequence[Path]) -> None:
        files = [paths] if isinstance(paths, Path) else sorted(paths)
        if not files:
            raise DataError("No log was named", remedy="Name at least one MCAP file")
        self.scans = [Scan(file) for file in files]
        self.foreign: Counter[str] = Counter()
        self.unparsable: Counter[str] = Counter()
        self._start_ns: int | None = None

    @property
    def name(self) -> str:
        """The name of the log for messages."""
        return str(self.scans[0].path) if len(self.scans) == 1 else f"{self.scans[0].path} (+ {len(self.scans) - 1})"

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The MCAP metadata of all parts; for equal names, that of the last part."""
        return {name: dict(values) for scan in self.scans for name, values in scan.metadata.items()}

    @property
    def boards(self) -> set[str]:
        """The names of the boards with a Board51 topic; complete after one pass."""
        return {
            parts[1] for scan in self.scans for channel in scan.channels.values() if (parts := _board_topic(channel))
        }

    @property
    def finished(self) -> bool:
        """Return whether every part has its end; valid after one pass."""
        return all(scan.finished for scan in self.scans)

    @property
    def start_ns(self) -> int:
        """The log time of the first message: 0 s of `start_s` and `end_s`."""
        if self._start_ns is None:
            starts = []
            for scan in self.scans:
                first = scan.first_ns if scan.first_ns is not None else next((m.time_ns for m in scan.messages()), None)
                starts += [] if first is None else [first]
            self._start_ns = min(starts, default=0)
        return self._start_ns

    def raw(
        self,
        *,
        topics_: Sequence[str] | None = None,
        boards: Sequence[str] | None = None,
        start_s: float = 0.0,
        end_s: float | None = None,
        from_byte: int = 0,
    ) -> Iterator[RawLogRecord]:
        """Yield unparsed records; damage is recorded in `scans` and skipped.

        Arguments as of `read`; `from_byte`: as of `Scan.messages`, of a log of one part.
        """
        self.foreign.clear()
        low_ns = self.start_ns + round(start_s * 1e9) if start_s > 0 else 0
        high_ns = 1 << 64 if end_s is None else self.start_ns + round(end_s * 1e9)
        for scan in self.scans:
            known: dict[McapChannel, tuple[str, str, str] | None] = {}
            for channel, time_ns, data in scan.messages(start_ns=low_ns, end_ns=high_ns, from_byte=from_byte):
                if channel not in known:
                    known[channel] = _board_topic(channel)
                parts = known[channel]
                if parts is None:
                    self.foreign[channel.topic] += 1
                    continue
                site, board, topic = parts
                if (topics_ is None or topic in topics_) and (boards is None or board in boards):
                    yield RawLogRecord(channel.topic, site, board, topic, data, time_ns)

    def records(
        self,
        *,
        topics_: Sequence[str] | None = None,
        boards: Sequence[str] | None = None,
        start_s: float = 0.0,
        end_s: float | None = None,
    ) -> Iterator[LogRecord]:
        """Yield parsed records, as `raw` does.  Messages that cannot be parsed are counted in `unparsable`."""
        self.unparsable.clear()
        for key, site, board, topic, data, time_ns in self.raw(
            topics_=topics_, boards=boards, start_s=start_s, end_s=end_s
        ):
            message = encoding.parse(topics.TOPIC_OF_NAME[topic].message, data)
            # Counted, not raised: one message that cannot be parsed must not cost all that follow.
            if message is None:
                self.unparsable[key] += 1
            else:
                yield LogRecord(key, site, board, topic, message, time_ns)

    def schema_of(self, key: str) -> str:
        """Return schema and encoding of a key's messages, as text."""
        for scan in self.scans:
            for channel in scan.channels.values():
                if channel.topic == key:
                    return f"{channel.schema.name if channel.schema else 'nothing'} ({channel.message_encoding})"
        return "nothing"

    def check_damage(self, *, last_ns: int | None, cut_is_damage: bool = True) -> None:
        """Raise a DataError if bytes were lost; call it after one pass.

        `last_ns` is the log time of the last message that was delivered.  Without `cut_is_damage` a file may end within
        a record.
        """
        for scan in self.scans:
            damages = [d for d in scan.damages if cut_is_damage or not d.is_cut]
            if damages:
                first = damages[0]
                until = f", readable to {(last_ns - self.start_ns) / 1e9:.3f} s" if last_ns is not None else ""
                lost = sum(damage.bytes for damage in damages)
                raise DataError(
                    f"Log {scan.path} is damaged at byte {first.offset} of {scan.size}: {first.reason}; "
                    f"{lost} bytes lost{until}",
                    remedy=f"Run: board51 recover {scan.path} -o clean.mcap",
                )

    def check(self, *, last_ns: int | None) -> None:
        """Raise a DataError for damage, or for a log without Board51 messages; call it after one pass."""
        self.check_damage(last_ns=last_ns)
        if not self.boards:
            foreign_topics = sorted({channel.topic for scan in self.scans for channel in scan.channels.values()})
            holds = (
                f"only {', '.join(foreign_topics[:5])}{' ...' if len(foreign_topics) > 5 else ''}"
                if foreign_topics
                else "no channels at all"
            )
            raise DataError(
                f"Log {self.name} holds no Board51 messages: {holds}",
                remedy="Name a log written by board51, or import the recording with board51 import",
            )


def read(
    path: Path | Sequence[Path],
    topics: Sequence[str] | None = None,
    boards: Sequence[str] | None = None,
    start_s: float = 0.0,
    end_s: float | None = None,
) -> Iterator[LogRecord]:
    """Yield the records of a log, an MCAP file or its parts, in the order of the file.

    By default they are of all topics and boards.  `start_s` and `end_s` count from the first message of the log, s.

    Raises:
        DataError: the file is absent, empty, not MCAP, or holds no Board51 messages.  A damaged file raises it after
            all intact records have been delivered.
    """
    reader = LogReader(path)
    last_ns = None
    for record in reader.records(topics_=topics, boards=boards, start_s=start_s, end_s=end_s):
        last_ns = record.time_ns
        yield record
    # At the end, not at the first damage: the caller gets all intact records before the error.
    reader.check(last_ns=last_ns)


def _board_topic(channel: McapChannel) -> tuple[str, str, str] | None:
    parts = topics.split(channel.topic)
    if parts is None or channel.message_encoding != encoding.MESSAGE_ENCODING:
        return None
    # The schema may be lost with the first chunk; the topic says the same.
    lost = channel.schema is None and channel.schema_id != 0
    name = encoding.schema_name(topics.TOPIC_OF_NAME[parts[2]].message)
    return parts if lost or (channel.schema is not None and channel.schema.name == name) else None
