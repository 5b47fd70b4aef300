"""A line full of PINGs, past the session: their ids would meet its own, and it would take their answers for its own.

Begin a new session after it: the board then forgets the ids of the flood.
"""

from __future__ import annotations

from itertools import pairwise

from gateway.selftest.wire import Wire
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import RESETS, EventCode, Message

_BITS_PER_BYTE = 10  # 8N1
_AHEAD_S = 0.01  # so much may wait in this computer: a STOP stands behind it
_STOP_ID = 255
_RESTART = 1000


class Flood:
    """Counts what it sends into a line of `baud` bit/s and what comes back."""

    def __init__(self, wire: Wire, baud: int) -> None:
        self.states: list[tuple[float, State]] = []  # arrival, s
        self.pings = self.answers = self.restarts = 0
        self.overload = False
        self.stop_s: float | None = None  # when the last byte of STOP was written
        self._wire = wire
        self._bytes_per_s = baud / _BITS_PER_BYTE
        self._decoder = StreamDecoder()
        self._rest = b""
        self._stop = False

    def run(self, duration_s: float, *, stop_at_s: float | None = None) -> None:
        """Send PINGs as fast as the line takes them; a STOP among them at `stop_at_s`."""
        started_s, written = self._wire.now_s(), 0
        while (elapsed_s := self._wire.now_s() - started_s) < duration_s or self._rest:
            room = int((elapsed_s + _AHEAD_S) * self._bytes_per_s) - written
            while room > 0 and (self._rest or elapsed_s < duration_s):
                if not self._rest:
                    self._rest = self._next(stop=stop_at_s is not None and elapsed_s >= stop_at_s)
                accepted = self._wire.write(self._rest)
                if not accepted:
                    break
                self._rest, written, room = self._rest[accepted:], written + accepted, room - accepted
                if self._stop and not self._rest and self.stop_s is None:
                    self.stop_s = self._wire.now_s()
            self._read(1e-3)

    def drain(self, duration_s: float) -> None:
        """Read what still comes."""
        end_s = self._wire.now_s() + duration_s
        while (left_s := end_s - self._wire.now_s()) > 0.0:
            self._read(left_s)

    @property
    def lost_states(self) -> int:
        """The number of ticks without a state."""
        steps = ((b.sequence - a.sequence) & 0xFFFF for (_, a), (_, b) in pairwise(self.states))
        return sum(step - 1 for step in steps if step < _RESTART)  # a restart is found by the next handshake

    def _next(self, *, stop: bool) -> bytes:
        if stop and not self._stop:
            self._stop = True
            return encode_frame(encode_body("STOP", id=_STOP_ID))
        self.pings += 1
        return encode_frame(encode_body("PING", id=self.pings % (_STOP_ID - 1) + 1))

    def _read(self, timeout_s: float) -> None:
        if not self._wire.wait(timeout_s):
            return
        now_s = self._wire.now_s()
        for item in self._decoder.feed(self._wire.read() or b""):
            if isinstance(item, State):
                self.states.append((now_s, item))
            elif isinstance(item, Message) and item.name == "EVENT":
                self.overload |= item.int("code") == EventCode.OVERLOAD
                self.restarts += item.int("code") in RESETS
            elif isinstance(item, Message):
                self.answers += item.name == "PONG" or (item.name == "NACK" and item.int("id") != _STOP_ID)
