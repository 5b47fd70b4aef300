"""Decodes the byte stream of the UART into events.  No I/O, no clock, no threads.

Read `framing.py` first (one frame), then `messages.py` (one body), then this file (the stream).
`protocol/README.md` shows the bytes; if they disagree, that page is right.

Rule 1: no input raises an error.  Line noise is information about the link: it is reported as a `BadFrame`, and
        decoding continues.
Rule 2: the result does not depend on how the bytes are split into reads.
Rule 3: a frame ends at 0x00, whatever precedes it.  Each frame has a delimiter at both ends, so a damaged frame never
        destroys the next one.
"""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import dataclass
from typing import NamedTuple

from protocol.wire.codec import BODY_SIZE, decode_body
from protocol.wire.framing import MAX_ENCODED, cobs_decode
from protocol.wire.messages import ROW_OF_NAME, Message

CAUSES = ("cobs", "crc", "type", "length", "range", "oversize")


class State(NamedTuple):
    """A STATE frame, in counts.  A tuple for speed: each board sends 500 of them per second."""

    sequence: int
    i_c: int
    x: int
    u_c: int
    x_ref: int
    flags: int  # bits 0-1 mode, 2-7 messages.Flag


@dataclass(frozen=True, slots=True)
class BadFrame:
    """The bytes between two delimiters that are not a frame.  `cause` is one of CAUSES."""

    cause: str
    data: bytes  # as received, at most MAX_ENCODED + 1 bytes


Event = State | Message | BadFrame

_STATE = ROW_OF_NAME["STATE"].type
_STATE_SIZE = BODY_SIZE["STATE"] + 2


class StreamDecoder:
    """Decodes a byte stream into states, messages and bad frames.

    Use one decoder per connection and direction.  The bytes of an unfinished frame wait for their delimiter.  A frame
    longer than MAX_ENCODED is reported once, as `oversize`, when its delimiter arrives.
    """

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[Event]:
        """Return the events that `data` completes, in order; never raises."""
        # By delimiters, not by lengths: a damaged length would take the next frame with it.
        *frames, rest = (self._pending + data).split(b"\x00")
        events: list[Event] = []
        for frame in frames:
            if not frame:  # the delimiter at the start of a frame, right after the one at the end of the last
                continue
            if len(frame) > MAX_ENCODED:
                events.append(BadFrame("oversize", frame[: MAX_ENCODED + 1]))
                continue
            events.append(_decode(frame))
        # Limit the bytes kept of an endless frame: otherwise line noise could exhaust the memory.
        self._pending = rest[: MAX_ENCODED + 1]
        return events


def _decode(frame: bytes) -> Event:
    body = cobs_decode(frame)
    if body is None or len(body) < 3:
        return BadFrame("cobs", frame)
    if crc_hqx(body, 0xFFFF) != 0:
        return BadFrame("crc", frame)
    # By hand, not by the table: each board sends 500 states a second, and hardly anything else.
    if body[0] == _STATE and len(body) == _STATE_SIZE:  # the same layout as the table's row; a test compares both
        if body[9] & 3 == 3:  # there is no mode 3
            return BadFrame("range", frame)
        counts = int.from_bytes(body[3:9], "little")
        return State(
            body[1] | body[2] << 8,
            counts & 0xFFF,
            counts >> 12 & 0xFFF,
            counts >> 24 & 0xFFF,
            counts >> 36,
            body[9],
        )
    message = decode_body(body[:-2])
    return BadFrame(message, frame) if isinstance(message, str) else message
