"""Writes one MCAP file: `write` to memory, `flush` to disk, `close` with an index.  Not thread-safe (`recorder` is).

Rule 1: the file grows by whole chunks only.  foxglove-sdk writes into memory; `flush` finishes the chunk and passes the
        bytes to the kernel in one call.  `kill -9` therefore loses only messages after the last `flush`.
Rule 2: no error is silent.  When foxglove-sdk writes to a file itself, it only prints a failed write and then refuses
        all further ones.  Here, after a failed write, the file is cut back to its last whole chunk.  The bytes are
        kept, and `flush` or `close` may be called again when the disk has space.
Rule 3: an existing file is never changed.
Rule 4: chunks are small, however rarely the caller flushes, and channel descriptions are repeated between them.  Damage
        therefore affects only the chunks that contain it; the others can be read without the first chunk (with the
        descriptions) and without the index at the end.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from foxglove import Context, Schema, open_mcap
from foxglove.mcap import MCAPCompression, MCAPWriteOptions

from protocol.bus import encoding, topics
from protocol.errors import ServiceError
from protocol.log.chunk import channel_records

if TYPE_CHECKING:
    from foxglove._foxglove_py import BaseChannel

Compression = Literal["zstd", "lz4", "none"]
DESCRIBE_BYTES = 1 << 16  # of the file between two descriptions of its channels; each channel takes 60 bytes
HELD_BYTES = 4 << 20  # without `flush` (an import), data is written to disk in pieces of this size

_COMPRESSION = {"zstd": MCAPCompression.Zstd, "lz4": MCAPCompression.Lz4, "none": None}
_REASONS: dict[int, tuple[str, str]] = {
    errno.ENOSPC: ("disk full", "Free space on that file system"),
    errno.EDQUOT: ("disk full", "Free space within the quota"),
    errno.EROFS: ("read-only", "Choose a log directory on a writable file system"),
    errno.EACCES: ("no permission", "Give this user write permission, or choose another log directory"),
    errno.EPERM: ("no permission", "Give this user write permission, or choose another log directory"),
    errno.ENOENT: ("no such directory", "Create the directory, or choose another one"),
    errno.ENOTDIR: ("not a directory", "Choose a directory for the logs"),
    errno.EEXIST: ("exists already", "Choose another name: logs are never overwritten"),
    errno.EFBIG: ("file too large", "Rotate earlier, or raise the limit on file size"),
}


class LogError(ServiceError):
    """The log cannot be written.  `reason` is short and stable: "disk full", "read-only", "no permission", ..."""

    def __init__(self, path: Path, error: OSError) -> None:
        known = _REASONS.get(error.errno or 0)
        self.reason, remedy = known or (os.strerror(error.errno or 0).lower(), "Check that disk")
        super().__init__(f"Log {path} cannot be written: {self.reason}", remedy=remedy)

    @property
    def is_disk_full(self) -> bool:
        """Return whether the error may disappear when space becomes free."""
        return self.reason == "disk full"


class _Memory:
    """File object for foxglove-sdk: the part that is on disk already, and `held`, which is not.

    The library seeks back only to the start of the current chunk, never into the part on disk.
    """

    def __init__(self) -> None:
        self.on_disk = 0
        self.held = bytearray()
        self._position = 0

    @property
    def end(self) -> int:
        """Size of the whole file, in memory and on disk."""
        return self.on_disk + len(self.held)

    def write(self, data: bytes | bytearray) -> int:
        at = self._position - self.on_disk
        self.held[at : at + len(data)] = data
        self._position += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        start = (0, self._position, self.end)[whence]
        if start + offset < self.on_disk:
            raise OSError(errno.ESPIPE, "that part is on disk already")
        self._position = start + offset
        return self._position

    def flush(self) -> None:
        pass


class LogWriter:
    """An MCAP file that is being written; as a context manager it is closed at the end, or after an error deleted.

    Args:
        path: File to create; it must not exist.
        metadata: MCAP metadata records, by name; written first, so that they survive a kill.
        compression: Of the chunks.  lz4 costs least; zstd suits imports that are written once and kept.

    Raises:
        LogError: the file cannot be created.
    """

    def __init__(
        self, path: Path, *, metadata: Mapping[str, Mapping[str, str]] | None = None, compression: Compression = "lz4"
    ) -> None:
        self.path = path
        try:
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        except OSError as error:
            raise LogError(path, error) from None
        self.messages = 0
        self._finished = False
        self._memory = _Memory()
        self._context = Context()  # its own: channels of one file must not reach another file or a Foxglove server
        self._descriptors = encoding.descriptor_set()
        self._channels: dict[str, BaseChannel] = {}
        self._mcap = open_mcap(
            self._memory,
            context=self._context,
            writer_options=MCAPWriteOptions(
                compression=_COMPRESSION[compression],
                chunk_size=None,  # `_end_chunk` ends them
                calculate_data_section_crc=False,  # it would not cover our descriptions; each chunk has a CRC
                compression_threads=0,
            ),
        )
        self._in_chunk = 0  # bytes
        self._described: dict[int, bytes] = {}  # by channel: its record, as the library wrote it
        self._described_at = 0
        for name, values in (metadata or {}).items():
            self._mcap.write_metadata(name, dict(values))
        self._mcap.flush()
        try:
            self._to_disk()
        except LogError:  # leave no empty file
            self.abandon()
            path.unlink(missing_ok=True)
            raise
        self._chunk_at = self._memory.end  # where the current chunk begins

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        try:
            if error is None:
                self.close()
        finally:
            if self._fd >= 0:
                self.abandon()
                with suppress(OSError):
                    self.path.unlink()

    @property
    def bytes_written(self) -> int:
        """The bytes handed to the operating system."""
        return self._memory.on_disk

    def whereabouts(self) -> Literal["here", "elsewhere", "gone"]:
        """Return whether the file is still under its name, was moved or replaced, or was deleted."""
        if os.fstat(self._fd).st_nlink == 0:
            return "gone"
        try:
            return "here" if os.path.samestat(os.stat(self.path), os.fstat(self._fd)) else "elsewhere"
        except OSError:
            return "elsewhere"

    def write(self, key: str, data: bytes, time_ns: int, *, schema: Callable[[], Schema] | None = None) -> None:
        """Add one message.

        Args:
            key: `<site>/<board>/<topic>` with a topic of `protocol.bus.topics`, or any other one with a `schema`.
            data: The serialised protobuf message of that topic.
            time_ns: MCAP log time, Unix time.
            schema: For a topic that is not in the bus table.

        Raises:
            ValueError: the key is not a Board51 key.
            LogError: data could not be written to disk.
        """
        channel = self._channels.get(key) or self._open_channel(key, schema)
        channel.log(data, time_ns)
        self.messages += 1
        self._in_chunk += len(data)
        if self._in_chunk >= encoding.CHUNK_BYTES:
            self._end_chunk()
            if len(self._memory.held) > HELD_BYTES:
                self._to_disk()

    def flush(self) -> None:
        """Finish the chunk and give everything to the operating system.

        Raises:
            LogError: nothing of the chunk is in the file; the bytes are kept for the next call.
        """
        if not self._finished:
            self._end_chunk()
        self._to_disk()

    def close(self) -> None:
        """Flush, write the index, sync to the medium.  Does nothing the second time.

        Raises:
            LogError: a part could not be written; call again when there is space, or `abandon`.
        """
        if self._fd < 0:
            return
        if not self._finished:
            self._end_chunk()
            self._mcap.close()
            self._finished = True
            for channel in self._channels.values():
                channel.close()
        self._to_disk()
        try:
            os.fsync(self._fd)
        except OSError as error:
            raise LogError(self.path, error) from None
        self.abandon()

    def abandon(self) -> None:
        """Leave the file as it is: whole chunks, perhaps without an index (`board51 recover` adds it)."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _open_channel(self, key: str, foreign: Callable[[], Schema] | None) -> BaseChannel:
        schema = self._schema(key) if foreign is None else foreign()
        # Not a `Channel`: the library keeps each of these for ever, with its schema.
        channel = self._context._create_channel(key, message_encoding=encoding.MESSAGE_ENCODING, schema=schema)  # noqa: SLF001
        self._channels[key] = channel
        return channel

    def _schema(self, key: str) -> Schema:
        parts = topics.split(key)
        if parts is None:
            raise ValueError(f"{key!r} is not a key of the bus table")
        name = encoding.schema_name(topics.TOPIC_OF_NAME[parts[2]].message)
        return Schema(name=name, encoding=encoding.SCHEMA_ENCODING, data=self._descriptors)

    def _end_chunk(self) -> None:
        memory = self._memory
        self._mcap.flush()
        new = len(self._described) < len(self._channels)
        if new:
            self._described |= channel_records(bytes(memory.held[self._chunk_at - memory.on_disk :]))
        if new or memory.end - self._described_at >= DESCRIBE_BYTES:
            memory.seek(0, os.SEEK_END)
            memory.write(b"".join(self._described.values()))
            self._described_at = memory.end
        self._in_chunk, self._chunk_at = 0, memory.end

    def _to_disk(self) -> None:
        memory = self._memory
        written = 0
        try:
            os.lseek(self._fd, memory.on_disk, os.SEEK_SET)
            with memoryview(memory.held) as view:
                while written < len(view):
                    written += os.write(self._fd, view[written:])
        except OSError as error:
            os.ftruncate(self._fd, memory.on_disk)  # half a chunk would stop every reader there
            raise LogError(self.path, error) from None
        memory.on_disk += written
        memory.held.clear()
