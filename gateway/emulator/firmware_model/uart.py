"""The board's UART: transmits frames by priority at the baud rate, and receives frames.

Rule 1: a frame that has begun is finished first; then STATE, answers, EVENT, CAPTURE_BLOCK (rule 5 of
        protocol/README.md).  So STATE waits for one frame at most.
Rule 2: every queue is bounded.  A full STATE queue loses its oldest (the newest tells most), the others refuse the
        newest; each loss is counted, and the host sees it by sequence, by number or by a repeated command.
Rule 3: a byte takes 10 bit times.  Idle time of the line is not accumulated.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections import deque
from collections.abc import Iterator
from enum import IntEnum

from protocol.wire.framing import MAX_ENCODED, cobs_decode

_BITS_PER_BYTE = 10  # 8N1


class Priority(IntEnum):
    """The priority of transmission, highest first."""

    STATE = 0
    ANSWER = 1
    EVENT = 2
    CAPTURE_BLOCK = 3


_DEPTH = {Priority.STATE: 8, Priority.ANSWER: 8, Priority.EVENT: 16, Priority.CAPTURE_BLOCK: 8}  # frames


class Outbox:
    """The queues of frames for the transmitter."""

    def __init__(self) -> None:
        self._queues: tuple[deque[bytes], ...] = tuple(deque() for _ in Priority)
        self.dropped = 0

    def put(self, frame: bytes, priority: Priority) -> None:
        """Queue a frame; if the queue is full, one frame is lost and counted."""
        queue = self._queues[priority]
        if len(queue) >= _DEPTH[priority]:
            self.dropped += 1
            if priority is not Priority.STATE:
                return
            queue.popleft()
        queue.append(frame)

    def take(self) -> bytes:
        """Return the next frame for the line, or b""."""
        for queue in self._queues:
            if queue:
                return queue.popleft()
        return b""

    def clear(self) -> None:
        """Discard all frames, as a reset does; the count of lost frames stays."""
        for queue in self._queues:
            queue.clear()

    def full(self, priority: Priority) -> bool:
        """Return whether the next frame of this priority would be lost, or make another one be."""
        return len(self._queues[priority]) >= _DEPTH[priority]

    def waiting(self, priority: Priority) -> int:
        """Return the number of waiting frames of this priority."""
        return len(self._queues[priority])


class Inbox:
    """Receiver: decodes bytes from the host into bodies with a correct CRC."""

    def __init__(self) -> None:
        self._pending = b""
        self.bad_frames = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the bodies (without CRC) of the frames that `data` completes, one by one; count invalid frames."""
        *frames, rest = (self._pending + data).split(b"\x00")
        self._pending = rest[: MAX_ENCODED + 1]  # the buffer of the board; a longer frame is lost, the next is not
        for frame in filter(None, frames):  # nothing is between two delimiters in a row
            body = cobs_decode(frame) if len(frame) <= MAX_ENCODED else None
            if body is None or len(body) < 3 or crc_hqx(body, 0xFFFF) != 0:
                self.count_bad()
            else:
                yield body[:-2]

    def count_bad(self) -> None:
        """Count a frame that is not answered."""
        self.bad_frames = min(self.bad_frames + 1, 0xFFFF)


class Pacer:
    """Computes how many bytes a line of `baud` bits per second carries over time."""

    def __init__(self, baud: int) -> None:
        self._baud = baud
        self._credit = 0  # bits times microseconds per second, so that nothing is rounded
        self.byte_us = 1_000_000 * _BITS_PER_BYTE // baud

    def allow(self, duration_us: int) -> int:
        """Return the number of bytes that may pass in this time; report the actual number with `spend`."""
        self._credit += self._baud * duration_us
        return self._credit // (_BITS_PER_BYTE * 1_000_000)

    def spend(self, count: int, *, more: bool) -> None:
        """Note that `count` bytes passed; without `more` bytes waiting, the rest of the time is idle and lost."""
        self._credit -= count * _BITS_PER_BYTE * 1_000_000
        if not more:
            self._credit = 0
