"""MCAP logs for the twin: read messages in the order they were written, and write twin topics.

Rule 1: messages are read in the order of the file, so a twin over a log repeats what it did live.
Rule 2: an unfinished file (its writer was killed) is read up to its end; `LogReader.finished` tells whether it was
        closed.
Rule 3: a channel is identified by its key *and* its schema.  A foreign message under one of our keys is an error.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from google.protobuf.message import Message
from mcap.writer import Writer

from protocol.bus import encoding
from protocol.bus.topics import TOPIC_OF_NAME, split
from protocol.errors import DataError
from protocol.log.reader import LogReader, RawLogRecord


def entries(log: LogReader, *, topics: Collection[str], board: str | None = None) -> Iterator[RawLogRecord]:
    """The messages of `log` on some topics.

    Args:
        log: an MCAP log of board51.
        topics: names of `protocol.bus.topics` to read.
        board: only this board; None: all.

    Raises:
        DataError: after the intact messages, if the file is damaged or has messages of another type under our keys.
    """
    last_ns = None
    for record in log.raw(topics_=tuple(topics), boards=None if board is None else (board,)):
        last_ns = record.time_ns
        yield record
    # After the intact messages: a twin over a log keeps what it has read.
    for key in log.foreign:
        parts = split(key)
        if parts is not None and parts[2] in topics and board in (None, parts[1]):
            expected = encoding.schema_name(TOPIC_OF_NAME[parts[2]].message)
            raise DataError(
                f"{log.name}: {key} holds {log.schema_of(key)}, not {expected}",
                remedy="Give a log that board51 wrote",
            )
    log.check_damage(last_ns=last_ns, cut_is_damage=False)


def parse(message_type: type[encoding.M], entry: RawLogRecord, where: Path) -> encoding.M:
    """Parse the message of an entry; `where` names the file in errors.  Raises DataError if it is damaged."""
    message = encoding.parse(message_type, entry.data)
    if message is None:
        raise DataError(
            f"{where}: a message of {entry.key} at {entry.time_ns} ns is damaged",
            remedy="Try `board51 recover` on it",
        )
    return message


class TwinLog:
    """Writer of an MCAP file of bus messages, in the order of the calls; a context manager.

    Raises:
        DataError: the file exists or cannot be written; a log is never overwritten.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            # The system refuses an existing file: a test before could be overtaken by another process.
            self._file = Path(path).open("xb")
        except OSError as error:
            raise DataError(f"{path}: cannot be written ({error.strerror})", remedy="Give a new file name") from error
        self._writer = Writer(self._file, chunk_size=encoding.CHUNK_BYTES)
        self._writer.start(profile="", library="board51 twin")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def __enter__(self) -> TwinLog:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.finish()
        self._file.close()

    def write(self, key: str, message: Message | bytes, *, message_type: type[Message], log_time_ns: int) -> None:
        """Append a message under a bus key."""
        channel = self._channels.get(key)
        if channel is None:
            name = encoding.schema_name(message_type)
            if name not in self._schemas:
                self._schemas[name] = self._writer.register_schema(
                    name, encoding.SCHEMA_ENCODING, encoding.descriptor_set()
                )
            channel = self._writer.register_channel(key, encoding.MESSAGE_ENCODING, self._schemas[name])
            self._channels[key] = channel
        data = message if isinstance(message, bytes) else message.SerializeToString(deterministic=True)
        self._writer.add_message(channel, log_time=log_time_ns, data=data, publish_time=log_time_ns)
