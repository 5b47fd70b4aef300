"""Logs for offline use: messages out of an MCAP file in the order they were written, and twin topics into one.

Rule 1: the order of the file is the order of the day: what came first when it was recorded comes first again, so a twin
        that reads a log does what it did live.
Rule 2: an unfinished file (its writer was killed) is read as far as it goes; `LogReader.complete` says which it was.
Rule 3: a channel counts by its key *and* its schema.  A foreign message under our key is an error, not data.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from google.protobuf.message import Message
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import Writer
from zstandard import ZstdError

from protocol.bus import encoding
from protocol.bus.topics import BY_NAME, split
from protocol.errors import DataError
from protocol.files import open_regular

# What reading a truncated or damaged record raises: mcap, its decompressors and struct each have their own.
_DAMAGE = (McapError, ValueError, RuntimeError, EOFError, struct.error, ZstdError)
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<xQHxxxxQxxxxxxxx")  # of a whole record: size, channel, log time
_IS_MESSAGE = int(Opcode.MESSAGE)


class Entry(NamedTuple):
    """One message of a log, not yet parsed."""

    site: str
    board: str
    topic: str
    log_time_ns: int
    data: bytes


class LogReader:
    """An MCAP file of ours.

    Args:
        path: of the file.
        topics: names of `protocol.bus.topics` to read.
        board: only this board; None: all.

    Raises (on iteration):
        DataError: no such file, not MCAP, damaged, or a message of another type under one of our keys.
    """

    def __init__(self, path: str | Path, *, topics: Collection[str], board: str | None = None) -> None:
        self.path = Path(path)
        self.complete = False  # after iteration: whether the file was closed properly
        self.boards: set[str] = set()  # seen under any topic of ours
        self._topics = frozenset(topics)
        self._board = board
        self._schemas: dict[int, str] = {}
        self._wanted: dict[int, tuple[str, str, str]] = {}

    def __iter__(self) -> Iterator[Entry]:
        seen = 0
        try:
            with open_regular(self.path, remedy="Give an MCAP log") as file:
                try:
                    longest = os.fstat(file.fileno()).st_size
                    for record in StreamReader(file, emit_chunks=True, record_size_limit=longest).records:
                        seen += 1
                        if isinstance(record, Chunk):
                            yield from self._chunk(record)
                        elif isinstance(record, Schema | Channel):
                            self._declare(record)
                        elif isinstance(record, McapMessage) and record.channel_id in self._wanted:
                            yield Entry(*self._wanted[record.channel_id], record.log_time, record.data)
                        elif isinstance(record, Footer):
                            self.complete = True
                except _DAMAGE as error:
                    # At the end of the file it is the record the writer was killed in; elsewhere it is damage.
                    if not seen or file.read(1):
                        raise DataError(
                            f"{self.path}: not a readable MCAP log ({error or 'it is empty'})",
                            remedy="Give an MCAP log of board51, or try `board51 recover` on it",
                        ) from error
        except OSError as error:
            raise DataError(f"{self.path}: cannot be read ({error.strerror})", remedy="Give an MCAP log") from error

    def _chunk(self, chunk: Chunk) -> Iterator[Entry]:
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        records = stream.read(length)
        wanted, message, head, payload = self._wanted, _MESSAGE.unpack_from, _RECORD.size, _MESSAGE.size
        at = 0
        # By hand: mcap's own `breakup_chunk` builds objects for every message, wanted or not, at 8 us each.
        while at < length:
            opcode = records[at]
            if opcode == _IS_MESSAGE:
                size, channel, log_time = message(records, at)
                end = at + head + size
                if channel in wanted:
                    site, board, topic = wanted[channel]
                    yield Entry(site, board, topic, log_time, records[at + payload : end])
            else:
                _, size = _RECORD.unpack_from(records, at)
                end = at + head + size
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    stream_of_one, _ = get_chunk_data_stream(_bare(records[at + head : end]))
                    read = Schema.read if opcode == Opcode.SCHEMA else Channel.read
                    self._declare(read(stream_of_one))
            at = end

    def _declare(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
            return
        found = split(record.topic)
        if found is None:
            return
        site, board, topic = found
        self.boards.add(board)
        if topic not in self._topics or (self._board is not None and board != self._board):
            return
        expected = encoding.schema_name(BY_NAME[topic].message)
        schema = self._schemas.get(record.schema_id, "nothing")
        if schema != expected or record.message_encoding != encoding.MESSAGE_ENCODING:
            raise DataError(
                f"{self.path}: {record.topic} holds {schema} ({record.message_encoding}), not {expected}",
                remedy="Give a log that board51 wrote",
            )
        self._wanted[record.id] = (site, board, topic)


def parse(message_type: type[encoding.M], entry: Entry, where: Path) -> encoding.M:
    """The message of an entry.  Raises DataError where the bytes are not one."""
    message = encoding.parse(message_type, entry.data)
    if message is None:
        raise DataError(
            f"{where}: a message of {entry.site}/{entry.board}/{entry.topic} at {entry.log_time_ns} ns is damaged",
            remedy="Try `board51 recover` on it",
        )
    return message


class TwinLog:
    """An MCAP file of bus messages, written in the order of the calls; a context manager.

    Raises DataError where the file exists already: a log is never overwritten.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            self._file = Path(path).open("xb")
        except OSError as error:
            raise DataError(f"{path}: cannot be written ({error.strerror})", remedy="Give a new file name") from error
        self._writer = Writer(self._file, chunk_size=encoding.CHUNK_BYTES)
        self._writer.start(profile="", library="board51 twin")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def __enter__(self) -> TwinLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]  # the library left it untyped
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


def _bare(data: bytes) -> Chunk:
    return Chunk(
        compression="",
        data=data,
        message_end_time=0,
        message_start_time=0,
        uncompressed_crc=0,
        uncompressed_size=len(data),
    )
