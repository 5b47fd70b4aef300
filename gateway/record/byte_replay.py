"""Replays the recorded bytes of a UART, so that the gateway can process them again.  No I/O, no clock.

Differences from the recording:

- Recorded answers are removed: they contain the ids of recorded commands, and could be taken for answers to new
  commands.  Everything else is sent byte for byte, including damaged frames and noise.
- HELLO, GET_PARAMETERS and PING get the board's answer of the log: the newest one at that time, or the one after a
  reset.  It has the new id and the tick that the stream has reached.
- All other commands are refused with NACK NOT_AVAILABLE: a recording cannot be influenced.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field

from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import RESETS, ROW_OF_NAME, Message, Reason, Value

_ANSWERS = frozenset({"IDENTITY", "PONG", "ACK", "NACK", "PARAMETERS", "CAPTURE_BLOCK"})


@dataclass(frozen=True, slots=True)
class Piece:
    """The bytes that are sent together, and the tick of the last state in them (None without a state)."""

    time_ns: int
    data: bytes
    tick: int | None


@dataclass(slots=True)
class _Known:
    """The answers of the board about itself, with the pieces from which they hold."""

    at: list[int] = field(default_factory=list)
    messages: list[Message] = field(default_factory=list)

    def add(self, at: int, message: Message) -> None:
        self.at.append(at)
        self.messages.append(message)

    def in_force_at(self, at: int, since: int) -> Message | None:
        """Return the newest answer up to piece `at`; if it precedes the reset at `since`, the first answer after it."""
        newest = bisect_right(self.at, at) - 1
        if newest >= 0 and self.at[newest] >= since:
            return self.messages[newest]
        after = bisect_left(self.at, since)
        if after < len(self.at):
            return self.messages[after]
        return self.messages[newest] if self.messages else None


class RecordedBoard:
    """A board that repeats recorded bytes.

    Send `pieces` in order; `answer` takes the bytes of the host and returns the bytes to send back.

    Args:
        raw: RawBytes of one board in the order of the log; bytes to the board are skipped.

    Raises:
        DataError: there are no bytes of the board, or no IDENTITY.
    """

    def __init__(self, raw: Iterable[pb.RawBytes]) -> None:
        self.pieces: list[Piece] = []
        self.removed = 0  # answers taken out of the stream
        self.refused = 0
        self._known = {name: _Known() for name in ("IDENTITY", "PARAMETERS", "PONG")}
        self._resets: list[int] = []
        self._host = StreamDecoder()
        self._board = StreamDecoder()
        rest = b""
        for chunk in raw:
            if not chunk.to_board:
                rest = self._take(chunk.host_time_ns, rest + chunk.data)
        if not self.pieces:
            raise DataError(
                "The log holds no bytes of the board",
                remedy="Give a gateway's own log, written without --lean, or replay without --bytes",
            )
        if not self._known["IDENTITY"].messages:
            raise DataError(
                "The log holds no IDENTITY: the board's scalings are unknown",
                remedy="Include the part of the log in which the board was connected, or replay without --bytes",
            )
        self._count_ticks()

    def _take(self, time_ns: int, data: bytes) -> bytes:
        """Add a piece of whole frames; returns the unfinished one."""
        end = data.rfind(b"\x00") + 1
        retained = bytearray()
        sequence: int | None = None
        for frame in data[:end].split(b"\x00")[:-1]:
            if not frame:
                continue
            event = self._board.feed(frame + b"\x00")[0]
            if isinstance(event, State):
                sequence = event.sequence
            elif isinstance(event, Message):
                if event.name in _ANSWERS:
                    self.removed += 1
                    if event.name in self._known:
                        self._known[event.name].add(len(self.pieces), event)
                    continue
                if event.name == "EVENT" and event.int("code") in RESETS:
                    self._resets.append(len(self.pieces))
            retained += b"\x00" + frame + b"\x00"
        if retained:
            self.pieces.append(Piece(time_ns, bytes(retained), sequence))
        return data[end:]

    def _count_ticks(self) -> None:
        """Unwrap the sequence numbers; every IDENTITY sets the tick."""
        anchors = {*self._resets, *self._known["IDENTITY"].at}
        tick: int | None = None
        for index, piece in enumerate(self.pieces):
            if index in anchors:
                tick = None
            if piece.tick is None:
                continue
            if tick is None:
                tick = _nearest_tick(self._identity(index).int("tick"), piece.tick)
            else:
                tick += (piece.tick - tick) & 0xFFFF
            self.pieces[index] = Piece(piece.time_ns, piece.data, tick)

    def _in_force(self, name: str, at: int) -> Message | None:
        """Return the answer that holds at piece `at`, with the newest reset up to it."""
        newest = bisect_right(self._resets, at) - 1
        return self._known[name].in_force_at(at, self._resets[newest] if newest >= 0 else 0)

    def _identity(self, at: int) -> Message:
        identity = self._in_force("IDENTITY", at)
        assert identity is not None  # checked at the start
        return identity

    def answer(self, data: bytes, *, position: int) -> bytes:
        """Return the board's answer to bytes from the host, while `position` is the next piece; it may be empty."""
        # As on the board, a damaged command is not answered: the host repeats it.
        messages = [event for event in self._host.feed(data) if isinstance(event, Message)]
        commands = [message for message in messages if ROW_OF_NAME[message.name].to_board]
        return b"".join(encode_frame(self._answer(command, position)) for command in commands)

    def _answer(self, command: Message, position: int) -> bytes:
        at = min(position, len(self.pieces) - 1)
        identity = self._identity(at)
        tick = self._tick(at, identity)
        number = command.int("id")
        if command.name == "HELLO":
            low, high = command.int("version_min"), command.int("version_max")
            if low <= identity.int("version") <= high:
                return _again(identity, id=number, tick=tick)
            return self._refuse(command, Reason.VERSION, identity.int("version"))
        if command.name == "PING":
            pong = self._in_force("PONG", at) or Message("PONG", {"bad_frames": 0, "overruns": 0})
            return _again(pong, id=number, tick=tick)
        parameters = self._in_force("PARAMETERS", at)
        if command.name == "GET_PARAMETERS" and parameters is not None:
            return _again(parameters, id=number)
        return self._refuse(command, Reason.NOT_AVAILABLE, 0)

    def _tick(self, at: int, identity: Message) -> int:
        """Return the tick of the next state, or that of IDENTITY if no state follows."""
        for piece in self.pieces[at:]:
            if piece.tick is not None:
                return piece.tick
        last = self.pieces[-1].tick
        return identity.int("tick") if last is None else last

    def _refuse(self, command: Message, reason: Reason, detail: int) -> bytes:
        self.refused += 1
        return encode_body(
            "NACK", id=command.int("id"), command=ROW_OF_NAME[command.name].type, reason=int(reason), detail=detail
        )


def _nearest_tick(tick: int, sequence: int) -> int:
    """Return the tick nearest to `tick` whose low 16 bits equal `sequence`."""
    step = (sequence - tick) & 0xFFFF
    nearest = tick + (step if step < 0x8000 else step - 0x10000)
    return nearest if nearest >= 0 else sequence


def _again(message: Message, **changed: Value) -> bytes:
    return encode_body(message.name, **{**message.values, **changed})
