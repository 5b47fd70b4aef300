"""Reads the messages of an MCAP file in one pass, finished or damaged; raises no errors after opening.

The stream reader of the `mcap` package stops with an exception at the first missing byte.  Its indexed reader needs the
end of the file, which a killed process never wrote.  This reader continues after damage.

Rule 1: only verified data is delivered: the CRC of each chunk is checked.  A chunk cut off by the end of the file gives
        the messages before the cut, which decompression reproduces exactly or not at all.
Rule 2: after damage the scan continues at the next chunk with a correct CRC.  The search starts right behind the last
        verified byte, because a damaged length may point anywhere.
Rule 3: every loss is recorded as a `Damage`: offset, number of bytes, reason.
Rule 4: memory and work are bounded by the size of the file: it unpacks to FREE_BYTES and LARGEST_RATIO times its size
        at most.  A chunk beyond that is a damage like any other, and the next one is read.

Format: mcap.dev/spec.  A record is opcode (1 byte), length (8), content; integers are little-endian.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from protocol.errors import DataError
from protocol.files import open_regular
from protocol.log.chunk import (
    CHUNK_HEAD,
    LARGEST_CHUNK,
    RECORD,
    records,
    stated_size,
    text,
    text_map,
    unpack,
    unpack_prefix,
)

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = range(1, 7)
_STATISTICS, _METADATA = 0x0B, 0x0C
_LAST_OPCODE, _FIRST_PRIVATE = 0x0F, 0x80
_CUT = "the file ends within"
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER_BYTES = RECORD.size + 20 + len(MAGIC)
_READ = (_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA)  # the others are skipped: attachments, indexes
LARGEST_RECORD = LARGEST_CHUNK + (1 << 20)  # bytes; an incompressible chunk is a little longer than its content
LARGEST_SUMMARY = 1 << 28  # bytes; the index of a log of 20 GB
# Samples pack 5 times, telegrams of nothing but zeros 140 times.  FREE_BYTES lets a short log of a silent sensor pass.
LARGEST_RATIO = 100
FREE_BYTES = 1 << 26
_PIECE = 1 << 20


class McapSchema(NamedTuple):
    """The name, encoding and description of a message type."""

    name: str
    encoding: str
    data: bytes


class McapChannel(NamedTuple):
    """A topic of the file."""

    id: int
    topic: str
    message_encoding: str
    schema_id: int  # 0: the channel has no schema
    schema: McapSchema | None  # None also if the schema record is lost


class McapMessage(NamedTuple):
    """A message as stored, not parsed."""

    channel: McapChannel
    time_ns: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """A range of bytes that could not be read."""

    offset: int
    bytes: int
    reason: str
    until_ns: int | None = None  # log time of the last message in it, if known

    @property
    def is_cut(self) -> bool:
        """Return whether the file ends here without its end mark: its writer was killed, or is still running."""
        return self.reason.startswith(_CUT)


class Scan:
    """A log file, opened for one or more passes.

    `damages`, `finished` and `unknown_channel` are complete once `messages` has been exhausted.

    Raises:
        DataError: the file is absent, unreadable, empty, or not MCAP.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.schemas: dict[int, McapSchema] = {}
        self.channels: dict[int, McapChannel] = {}
        self.metadata: dict[str, Mapping[str, str]] = {}
        self.damages: list[Damage] = []
        self.finished = False
        self.unknown_channel = 0  # messages of a channel whose description is lost
        self.library = ""
        self.size = _check(path)
        self.unpacked = 0  # bytes of chunks in this pass, also of those that were no chunks
        # Of the record that is being read.  After a pass: where the next one may begin, if the file has grown.
        self.offset = len(MAGIC)
        # From where, and the next intact chunk: the size if there is none.
        self._searched: tuple[int, int] | None = None
        self.first_ns: int | None = None  # the first log time, by the index
        self.last_ns: int | None = None  # the last one
        self.indexed = self._read_summary()  # if so, topics and times are known without a pass

    def grow(self) -> None:
        """Take in what was written since: the size, and the summary if there is one now.

        Raises:
            DataError: the file is gone or has become another one.
        """
        self.size = _check(self.path)
        self.indexed = self.indexed or self._read_summary()

    def messages(self, *, start_ns: int = 0, end_ns: int = 1 << 64, from_byte: int = 0) -> Iterator[McapMessage]:
        """Yield all messages with start_ns <= log time < end_ns, in the order of the file.

        With `from_byte`, the `offset` of an earlier pass, only what follows there is read.
        """
        self.damages.clear()
        self.unknown_channel = self.unpacked = 0
        self.finished = False
        self._searched = None
        with self.path.open("rb") as file:
            at = proven = max(from_byte, len(MAGIC))  # everything before `proven` was verified
            self.offset = at
            while at < self.size:
                file.seek(at)
                head = file.read(RECORD.size)
                opcode, length = RECORD.unpack(head) if len(head) == RECORD.size else (0, 0)
                end = at + RECORD.size + length
                if wrong := _why(head, opcode, end, self.size):
                    # Search from `proven`, not from `at`: a damaged length may have skipped whole chunks.
                    resumed = self._next_chunk(file, proven)
                    # A last chunk without its end is not given up: its first messages can still be decompressed.
                    if resumed is None and opcode == _CHUNK and end > self.size:
                        yield from self._cut_chunk(_read_at(file, at + RECORD.size, LARGEST_RECORD), at)
                        return
                    after = self.size if resumed is None else resumed
                    self._damage(min(at, after), abs(after - at), wrong)
                    if resumed is None:
                        return
                    self.offset = at = proven = resumed
                    continue
                content = file.read(length) if opcode in _READ else b""
                if opcode == _CHUNK:
                    start, stop = struct.unpack_from("<QQ", content) if length >= 16 else (0, 0)
                    # Only with an index: without it, a chunk that is passed over may hold the description of a channel.
                    if self.indexed and (stop < start_ns or start >= end_ns):
                        self.offset = at = end  # its channels are known from the index
                        continue
                    plain, problem = self._unpack(content)
                    if problem:
                        end = min(end, self._next_chunk(file, at + 1) or end)  # the length itself may be damaged
                        self._damage(at, end - at, problem, chunk=content)
                    else:
                        proven = end
                elif opcode == _FOOTER:
                    self.finished = _read_at(file, end, len(MAGIC) + 1) == MAGIC
                    if not self.finished:
                        self._damage(end, self.size - end, "the end mark is missing")
                    return
                else:
                    plain = head + content if opcode in _READ else b""
                for message in self._messages_between(plain, at, end):
                    if start_ns <= message.time_ns < end_ns:
                        yield message
                self.offset = at = end

    def _unpack(self, content: bytes) -> tuple[bytes, str]:
        """Unpack a chunk within what the file may still expand to; failed attempts count as well."""
        size = stated_size(content)
        left = FREE_BYTES + LARGEST_RATIO * self.size - self.unpacked
        if left < size <= LARGEST_CHUNK:
            return (
                b"",
                f"a chunk of {size} bytes, with which the file unpacks to more than {LARGEST_RATIO} times its size",
            )
        # Counted before it succeeds: a file of false heads would otherwise cost work without a bound.
        self.unpacked += size if size <= LARGEST_CHUNK else 0
        return unpack(content)

    def _next_chunk(self, file: BinaryIO, start: int) -> int | None:
        """Return the offset of the next chunk with a correct CRC, from `start` on."""
        if self._searched is None or not self._searched[0] <= start <= self._searched[1]:
            candidates = _chunk_heads(file, start, self.size)
            # Only a right CRC ends the search: the bytes of a chunk's head also occur within compressed data.
            intact = (at for at, length in candidates if not self._unpack(_read_at(file, at + RECORD.size, length))[1])
            self._searched = (start, next(intact, self.size))
        # The next damaged chunk asks again: without this answer, a file of them would be searched once for each.
        return self._searched[1] if self._searched[1] < self.size else None

    def _cut_chunk(self, content: bytes, at: int) -> Iterator[McapMessage]:
        plain = unpack_prefix(content)
        retained = 0
        for message in self._messages_between(plain, at, self.size, cut=True):
            retained += 1
            yield message
        self._damage(at, self.size - at, f"{_CUT} a chunk ({retained} messages of it are whole)", chunk=content)

    def _messages_between(self, plain: bytes, start: int, end: int, *, cut: bool = False) -> Iterator[McapMessage]:
        """Yield the messages among the records in `plain`, the content of the file from `start` to `end`."""
        at, size = 0, len(plain)
        unpack_record, unpack_message, channels = RECORD.unpack_from, _MESSAGE_HEAD.unpack_from, self.channels
        while at + 9 <= size:
            opcode, length = unpack_record(plain, at)
            at += 9
            if at + length > size:
                if not cut:
                    self._damage(start, end - start, "a chunk ends within a record")
                return
            if opcode == _MESSAGE and length >= 22:
                channel_id, _, time_ns, _ = unpack_message(plain, at)
                channel = channels.get(channel_id)
                # Counted, not guessed: a number alone does not tell which topic a message belongs to.
                if channel is None:
                    self.unknown_channel += 1
                else:
                    yield McapMessage(channel, time_ns, plain[at + 22 : at + length])
            elif opcode < _FIRST_PRIVATE and not self._take(opcode, plain[at : at + length]):
                self._damage(start, end - start, "a malformed record; its chunk is read up to it")
                return
            at += length

    def _take(self, opcode: int, content: bytes) -> bool:
        """Store a header, schema, channel or metadata record; return whether it was one."""
        try:
            if opcode == _SCHEMA:
                (schema_id,) = struct.unpack_from("<H", content)
                name, next_at = text(content, 2)
                encoding, next_at = text(content, next_at)
                self.schemas[schema_id] = McapSchema(name, encoding, content[next_at + 4 :])
            elif opcode == _CHANNEL:
                channel_id, schema_id = struct.unpack_from("<HH", content)
                topic, next_at = text(content, 4)
                encoding, _ = text(content, next_at)
                self.channels[channel_id] = McapChannel(
                    channel_id, topic, encoding, schema_id, self.schemas.get(schema_id)
                )
            elif opcode == _METADATA:
                name, next_at = text(content, 0)
                self.metadata[name] = text_map(content, next_at)
            elif opcode == _HEADER:
                _, next_at = text(content, 0)
                self.library, _ = text(content, next_at)
            else:
                return False
        except (struct.error, UnicodeDecodeError, IndexError):
            return False
        return True

    def _read_summary(self) -> bool:
        """Read schemas, channels and the first time from the summary at the end; return whether there is one."""
        if self.size < len(MAGIC) + _FOOTER_BYTES:
            return False
        with self.path.open("rb") as file:
            footer = _read_at(file, self.size - _FOOTER_BYTES, _FOOTER_BYTES)
            opcode, length = RECORD.unpack_from(footer)
            start, _, crc = struct.unpack_from("<QQI", footer, RECORD.size)
            if opcode != _FOOTER or length != 20 or not footer.endswith(MAGIC) or not 0 < start < self.size:
                return False
            # A summary is read as a whole, so its size is bounded. Without it the pass still finds all messages.
            if self.size - start > LARGEST_SUMMARY:
                return False
            summary = _read_at(file, start, max(0, self.size - _FOOTER_BYTES - start))
        if crc and zlib.crc32(footer[: RECORD.size + 16], zlib.crc32(summary)) != crc:
            return False  # do not use a damaged index: the pass finds the same records in the data
        for kind, content in records(summary):
            if kind == _STATISTICS and len(content) >= 46:
                count, first_ns, last_ns = struct.unpack_from("<Q18xQQ", content)
                if count:
                    self.first_ns, self.last_ns = first_ns, last_ns
            else:
                self._take(kind, content)
        return True

    def _damage(self, offset: int, size: int, reason: str, *, chunk: bytes = b"") -> None:
        until_ns = struct.unpack_from("<8xQ", chunk)[0] if len(chunk) >= 16 else 0
        if self.damages and (last := self.damages[-1]).reason == reason and last.offset + last.bytes == offset:
            self.damages.pop()  # one for all: a file of malformed records has one in each nine bytes
            offset, size, until_ns = last.offset, last.bytes + size, max(last.until_ns or 0, until_ns)
        self.damages.append(Damage(offset=offset, bytes=size, reason=reason, until_ns=until_ns or None))


def _check(path: Path) -> int:
    """Return the size of the file; raise DataError if it does not begin as an MCAP file."""
    remedy = f"Name the MCAP files in it: {path}/*.mcap" if path.is_dir() else "Name an MCAP file"
    with open_regular(path, remedy=remedy, what="Log ") as file:
        size = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
    if size == 0:
        raise DataError(f"Log {path} is empty", remedy="Nothing can be recovered from it; use another part")
    if magic != MAGIC:
        hint = "Name an MCAP file"
        if path.name.endswith((".csv", ".csv.gz", ".mat")):
            hint = "Turn it into one with board51 import"
        elif MAGIC.startswith(magic):
            hint = "It was cut off at its first bytes; use another part"
        raise DataError(f"{path} is not an MCAP file: it begins with {magic!r}", remedy=hint)
    return size


def _read_at(file: BinaryIO, at: int, size: int) -> bytes:
    file.seek(at)
    return file.read(size)


def _why(head: bytes, opcode: int, end: int, size: int) -> str:
    """Return why these bytes do not begin a record that can be read; "" if they do."""
    if len(head) < RECORD.size:
        return f"{_CUT} a record"
    if not (0 < opcode <= _LAST_OPCODE or opcode >= _FIRST_PRIVATE):
        return "not a record"
    if end > size:
        return f"{_CUT} a record" if opcode <= _LAST_OPCODE else "not a record"
    if opcode in _READ and RECORD.unpack(head)[1] > LARGEST_RECORD:
        return f"a record of more than {LARGEST_RECORD} bytes"
    return ""


def _chunk_heads(file: BinaryIO, start: int, size: int) -> Iterator[tuple[int, int]]:
    """Yield offset and length of what may be chunks, from `start` on."""
    head_bytes = RECORD.size + CHUNK_HEAD.size
    while len(piece := _read_at(file, start, _PIECE)) >= head_bytes:
        at = piece.find(_CHUNK)
        while 0 <= at <= len(piece) - head_bytes:
            _, length = RECORD.unpack_from(piece, at)
            (crc, name_length) = struct.unpack_from("<II", piece, at + head_bytes - 8)
            fits = length <= LARGEST_RECORD and start + at + RECORD.size + length <= size
            # Without a CRC nothing would tell a chunk from noise, so the search does not stop there.
            if crc and name_length <= 4 and fits:
                yield start + at, length
            at = piece.find(_CHUNK, at + 1)
        start += len(piece) - head_bytes + 1  # a head may lie across two pieces
