"""Queue of the commands to one board, and the bytes to write to its port.

Rule: frames do not wait in a buffer of bytes.  `SendQueue.output` gives one frame at a time, when the port has room.  A
      command that was given up or cancelled is not sent.  If its frame is partly written, the rest is dropped, and the
      board rejects the part by its CRC.  A STOP is sent even after it was given up: a late STOP is harmless.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, Message, Value

ANSWERS = {
    "HELLO": "IDENTITY",
    "PING": "PONG",
    "GET_PARAMETERS": "PARAMETERS",
    "READ_CAPTURE": "CAPTURE_BLOCK",
    "GET_HEALTH": "HEALTH",
    "GET_CALIBRATION": "CALIBRATION",
}  # all others: ACK


@dataclass(slots=True, eq=False)
class Command:
    """A command between its submission and its answer."""

    token: int  # 0: a command of the session itself
    name: str
    values: dict[str, Value]
    id: int = 0
    frame: bytes = b""
    tries: int = 0  # how often it was scheduled for writing
    attempts: int = 0  # how often at least one byte of it was written
    deadline_s: float = 0.0  # waiting: latest start of writing; outstanding: latest time of the answer

    def number(self, new_id: int) -> None:
        """Set the id, and encode the frame with it."""
        self.id = new_id
        self.frame = encode_frame(encode_body(self.name, id=new_id, **self.values))

    def accepts_answer(self, message: Message) -> bool:
        """Return whether `message`, which has the same id, is of a type that answers this command."""
        if message.name in ("ACK", "NACK"):
            good = message.int("command") == ROW_OF_NAME[self.name].type
            return good and (message.name == "NACK" or self.name not in ANSWERS)
        if message.name == "CAPTURE_BLOCK" and self.values.get("index") != message.int("index"):
            return False
        return ANSWERS.get(self.name) == message.name


class SendQueue:
    """The frames to write: commands in their order, a STOP before all others."""

    def __init__(self) -> None:
        self._due: deque[Command] = deque()
        self._writer: Command | None = None  # command whose frame is partly written
        self._rest = b""  # unwritten rest of that frame

    def clear(self) -> None:
        """Discard everything, for a new connection."""
        self._due.clear()
        self._rest = b""

    def output(self) -> bytes:
        """Return the next frame, or the rest of the current one; b"" if there is none."""
        if self._rest:
            return self._rest
        # One frame, not all that wait: a STOP can pass those that the port has not accepted yet.
        return self._due[0].frame if self._due else b""

    def wrote(self, count: int) -> None:
        """Note that the port has accepted `count` bytes of `output`."""
        if not self._rest and count:
            self._writer = self._due.popleft()
            # Counted at the first byte, not when it is due: with 0 attempts a command cannot have acted.
            self._writer.attempts += 1
            self._rest = self._writer.frame
        self._rest = self._rest[count:]

    def add(self, command: Command) -> None:
        """Schedule a command for writing unless it is scheduled already."""
        if command in self._due:
            return
        if command.name == "STOP":
            # In front of what waits, but not into a frame that is partly written: the board would reject both.
            self._due.appendleft(command)
        else:
            self._due.append(command)

    def withdraw(self, command: Command) -> None:
        """Cancel the repetition of a command; a scheduled STOP is written nevertheless."""
        if command in self._due and command.name != "STOP":
            self._due.remove(command)

    def drop(self, command: Command) -> None:
        """Remove a command that must not act any more, including the rest of its frame."""
        self.withdraw(command)
        # Half a frame is not a command: the board rejects it by its CRC. The whole frame would still act.
        if command is self._writer and command.name != "STOP":
            self._rest = b""

    def spare(self, stop: Command) -> None:
        """Remove a STOP that was given up, because another STOP is scheduled."""
        if stop in self._due and sum(c.name == "STOP" for c in self._due) > 1:
            self._due.remove(stop)
