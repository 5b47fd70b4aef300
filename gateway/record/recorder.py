"""Writes messages from any thread into MCAP parts, in a thread of its own.  `put` never blocks and never raises.

Rule 1: a full queue drops the OLDEST message and counts it.  Blocking the caller would move the loss to the serial
        driver, which would lose parts of frames.
Rule 2: every part stands alone: it is closed with an index, and begins with the newest `parameters` of every board.
Rule 3: at most `flush_s` plus one drain of data is in memory only: that is what `kill -9` costs.
Rule 4: a full disk or a failing one stops the log, not the caller.  It is reported once, the queue keeps the newest
        messages, and a new part begins when the disk is back; the part that was cut off is finished then, too.
        A disk that is full at the start delays the first part in the same way.
Rule 5: the next drain notices a part that was deleted or moved while it was written.  A new part begins, and the loss
        is reported.  The content of a deleted part is lost; a moved part is completed at its new place.
"""

from __future__ import annotations

import errno
import logging
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gateway.record.retention import delete_expired
from gateway.record.writer import Compression, LogError, LogWriter

OnEvent = Callable[[str, str, str], None]
Entry = tuple[str, bytes, int]

DRAIN_S = 0.02  # small batches: a long one would hold the interpreter while the serial thread waits
RETRY_S = 0.5  # how often a full or failed disk is tried again
RESUME_FACTOR = 1.2  # times min_free_bytes: otherwise a disk at the limit gives a part for every retry

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderStats:
    """The state of the log for the status message."""

    file: str  # name of the part being written, "" if none
    bytes: int  # of that part, on disk
    depth: int  # messages waiting
    dropped: int  # messages lost to a full queue, since the start
    written: int  # messages written, since the start
    parts: int
    state: str  # "writing" | "off" | "disk-full" | "failed: ..."


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderOptions:
    """The names, length and memory of the parts of a log."""

    prefix: str  # first part of the file names
    rotate_bytes: int  # a part larger than this is closed and the next one begun
    rotate_s: float  # the same by age, s
    flush_s: float = 0.1  # longest time between flushes, s
    queue: int = 20_000  # messages that may wait
    # With less free space the log pauses: the part in work can still be closed and the machine stays usable.
    min_free_bytes: int = 50_000_000
    keep_days: float = 0.0  # 0: no bound
    keep_gb: float = 0.0  # 0: no bound
    keep_unarchived: bool = False  # above both bounds
    compression: Compression = "lz4"  # of the chunks


class _Queue:
    """The messages that wait; a full queue drops the oldest.  Callable from any thread."""

    def __init__(self, capacity: int) -> None:
        self.dropped = 0
        self._capacity = capacity
        self._lock = threading.Lock()  # held for a few instructions only
        self._entries: deque[Entry] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    def put(self, key: str, messages: Iterable[bytes], time_ns: int) -> None:
        """Add messages of one key and time."""
        with self._lock:
            for data in messages:
                if len(self._entries) >= self._capacity:
                    self._entries.popleft()
                    self.dropped += 1
                self._entries.append((key, data, time_ns))

    def take(self) -> tuple[deque[Entry], int]:
        """Return (all messages, the number of those dropped so far)."""
        with self._lock:
            entries, self._entries = self._entries, deque()
            return entries, self.dropped

    def put_back(self, entries: deque[Entry]) -> None:
        """Add messages that were taken, before those that came since."""
        with self._lock:
            self._entries.extendleft(reversed(entries))

    def discard(self) -> None:
        """Drop all messages."""
        with self._lock:
            self.dropped += len(self._entries)
            self._entries.clear()


class Recorder:
    """Writes `<prefix>-<start>-<number>.mcap` files into `directory`.

    Args:
        directory: Must exist.
        options: Of the parts.
        metadata: MCAP metadata of every part.
        on_event: Called as (name, severity, text) in the recorder's thread, or by `start`: log-disk-full, log-failed,
            log-resumed, log-rotated, log-dropping, log-removed, log-deleted.
    """

    def __init__(
        self,
        directory: Path,
        options: RecorderOptions,
        *,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        on_event: OnEvent | None = None,
    ) -> None:
        self.directory = directory
        self.on_event = on_event
        self.files: list[Path] = []  # all parts that were begun
        self._options = options
        self._metadata = dict(metadata or {})
        self._queue = _Queue(options.queue)
        self._reported_dropped = 0

        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._run = ""
        self._part = 0
        self._cleared_part = -1  # the last one at whose begin old logs were deleted
        self._writer: LogWriter | None = None
        self._cut_off: LogWriter | None = None  # a part whose end did not fit on the disk
        self._parameters: dict[str, Entry] = {}
        self._opened_s = 0.0
        self._flushed_s = 0.0
        self._written = 0
        self._state = "off"

    def start(self, *, needs_room: bool = False) -> None:
        """Open the first part and start the thread.

        Raises:
            LogError: the directory is absent or cannot be written to, or the disk is full and the caller `needs_room`.
        """
        self._run = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        try:
            if needs_room:
                self._check_free_space()
            self._open_part()
            self._state = "writing"
        except LogError as error:
            if needs_room or not error.is_disk_full:
                raise
            self._pause(error)
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def put(self, key: str, data: bytes, time_ns: int) -> None:
        """Queue one message: key `<site>/<board>/<topic>`, serialised protobuf, Unix time in ns."""
        self.put_all(key, (data,), time_ns)

    def put_all(self, key: str, messages: Iterable[bytes], time_ns: int) -> None:
        """Queue messages of one key and time."""
        self._queue.put(key, messages, time_ns)

    def stats(self) -> RecorderStats:
        """Return a snapshot; callable from any thread."""
        writer = self._writer
        return RecorderStats(
            file=writer.path.name if writer else "",
            bytes=writer.bytes_written if writer else 0,
            depth=len(self._queue),
            dropped=self._queue.dropped,
            written=self._written,
            parts=self._part,
            state=self._state,
        )

    def close(self) -> None:
        """Write the queued messages and close the part, which is complete and readable afterwards."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None

    # --- the recorder's thread -----------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._stop.wait(DRAIN_S if self._writer else RETRY_S):
            self._step()
        self._step()
        self._finish()

    def _step(self) -> None:
        """Drain the queue once; afterwards the state is `writing`, or gives the reason why not."""
        try:
            if self._cleared_part < self._part:
                self._cleared_part, o = self._part, self._options
                limits = (o.keep_days, o.keep_gb, o.keep_unarchived)
                for severity, text in delete_expired(self.directory, o.prefix, *limits):
                    self._publish_event("log-deleted", severity, text)
            if self._writer is None:
                self._resume()
            elif (whereabouts := self._writer.whereabouts()) != "here":
                self._replace(self._writer, file_missing=whereabouts == "gone")
            self._check_free_space()
            self._drain()
            now_s = time.monotonic()
            if now_s - self._flushed_s >= self._options.flush_s:
                self._flush(now_s)
        except LogError as error:
            self._pause(error)
        except Exception as error:  # the recorder must not end silently: report the error and retry
            _logger.exception("recorder")
            self._pause(error)

    def _drain(self) -> None:
        assert self._writer is not None
        batch, dropped = self._queue.take()
        if dropped > self._reported_dropped:
            text = f"{dropped - self._reported_dropped} messages did not fit the queue"
            self._publish_event("log-dropping", "warning", text)
            self._reported_dropped = dropped
        write = self._writer.write
        try:
            while batch:
                entry = batch.popleft()
                if entry[0].endswith("/parameters"):
                    self._parameters[entry[0]] = entry
                try:
                    write(*entry)
                    self._written += 1
                except ValueError as error:  # a key outside the bus table: the caller's mistake, once per message
                    _logger.warning("not logged: %s", error)
        finally:  # a full disk in the middle of a batch: the rest waits for the next part
            self._queue.put_back(batch)

    def _flush(self, now_s: float) -> None:
        assert self._writer is not None
        self._writer.flush()
        self._flushed_s = now_s
        full = self._writer.bytes_written >= self._options.rotate_bytes
        if full or (now_s - self._opened_s >= self._options.rotate_s and self._writer.messages > len(self._parameters)):
            finished = self._writer
            finished.close()
            self._writer = None
            self._open_part()
            self._publish_event("log-rotated", "info", f"{finished.path.name} closed, {finished.bytes_written} bytes")

    def _replace(self, lost: LogWriter, *, file_missing: bool) -> None:
        """Continue in a new part, because the current one was moved or deleted."""
        self._writer = None
        if file_missing:
            lost.abandon()
            text = f"{lost.path.name} was deleted while it was written: its {lost.messages} messages are lost"
        else:
            lost.close()
            text = f"{lost.path.name} was moved or replaced while it was written; it was completed at its new path"
        self._publish_event("log-removed", "fault", f"{text}. Logging continues in a new part.")
        self._open_part()

    def _open_part(self) -> None:
        while True:
            name = f"{self._options.prefix}-{self._run}-{self._part:03d}.mcap"
            part = {"prefix": self._options.prefix, "run": self._run, "number": str(self._part)}
            metadata = {**self._metadata, "part": part}
            try:
                writer = LogWriter(self.directory / name, metadata=metadata, compression=self._options.compression)
                break
            except LogError as error:
                if error.reason != "exists already":
                    raise
                self._part += 1
        self._part += 1
        self.files.append(writer.path)
        for entry in self._parameters.values():
            writer.write(*entry)
        self._opened_s = self._flushed_s = time.monotonic()
        self._writer = writer

    def _check_free_space(self, factor: float = 1.0) -> None:
        try:
            if shutil.disk_usage(self.directory).free < factor * self._options.min_free_bytes:
                raise OSError(errno.ENOSPC, "below min_free_bytes")
        except OSError as error:
            raise LogError(self.directory, error) from None

    def _resume(self) -> None:
        self._check_free_space(RESUME_FACTOR)
        if self._cut_off is not None:
            self._finish_cut_off(self._cut_off)
        self._open_part()
        assert self._writer is not None
        self._state = "writing"
        self._publish_event("log-resumed", "info", f"Logging into {self._writer.path.name}")

    def _finish_cut_off(self, writer: LogWriter) -> None:
        """Complete a part that was cut off; a failure for another reason than space does not stop the log."""
        try:
            writer.close()
        except LogError as error:
            if error.is_disk_full:
                raise
            self._give_up(writer, error)
        self._cut_off = None

    def _give_up(self, writer: LogWriter, error: LogError) -> None:
        writer.abandon()
        text = f"{error} Its end is missing: board51 recover {writer.path.name} restores the rest"
        self._publish_event("log-failed", "fault", text)

    def _pause(self, error: Exception) -> None:
        """Close the part as far as the disk allows, and keep it to be completed later."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except LogError:
                self._cut_off = writer
        state, name, text = _describe(error, self._options.min_free_bytes)
        if state != self._state:
            self._state = state
            self._publish_event(name, "fault", text)

    def _finish(self) -> None:
        for writer in (self._cut_off, self._writer):
            if writer is not None:
                try:
                    writer.close()
                except LogError as error:
                    self._give_up(writer, error)
        if self._queue:
            self._queue.discard()
            lost = self._queue.dropped - self._reported_dropped
            self._publish_event("log-dropping", "warning", f"{lost} messages were not written")
        self._cut_off = self._writer = None
        self._state = "off"

    def _publish_event(self, name: str, severity: str, text: str) -> None:
        _logger.log(logging.INFO if severity == "info" else logging.WARNING, "%s: %s", name, text)
        if self.on_event is not None:
            try:
                self.on_event(name, severity, text)
            except Exception:  # an error in the caller's callback must not end the log
                _logger.exception("on_event")


def _describe(error: Exception, min_free_bytes: int) -> tuple[str, str, str]:
    """Return the state of a log that an error stops, and name and text of the event."""
    if not isinstance(error, LogError) or not error.is_disk_full:
        return f"failed: {error}", "log-failed", str(error)
    needed_mb = RESUME_FACTOR * min_free_bytes / 1e6
    needed = f" until {needed_mb:.0f} MB are free" if needed_mb else ""
    text = f"{error.problem}. {error.remedy}{needed}; logging then continues by itself."
    return "disk-full", "log-disk-full", text
