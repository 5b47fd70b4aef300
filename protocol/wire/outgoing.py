"""Commands on their way to one board, and what the port is given to write.

Rule: nothing waits as bytes.  `SendQueue.output` gives one frame at a time, when the port has room, and a command that
      was given up or cancelled has no frame any more; the rest of one that was begun is dropped, and the board's CRC
      drops what it got.  A STOP alone goes out also after it was given up: it can do no harm late.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import BY_NAME, Message, Value

ANSWERS = {
    "HELLO": "IDENTITY",
    "PING": "PONG",
    "GET_PARAMETERS": "PARAMETERS",
    "READ_CAPTURE": "CAPTURE_BLOCK",
}  # all others: ACK


@dataclass(slots=True, eq=False)
class Command:
    """One command, from its submission to its answer."""

    token: int  # 0: the session's own
    name: str
    values: dict[str, Value]
    id: int = 0
    frame: bytes = b""
    tries: int = 0  # times that it was to be written
    attempts: int = 0  # times that at least one byte of it was
    deadline_s: float = 0.0  # waiting: to be begun until then; outstanding: to be answered until then

    def number(self, new_id: int) -> None:
        """Give it its id, and with it its frame."""
        self.id = new_id
        self.frame = encode_frame(encode_body(self.name, id=new_id, **self.values))

    def is_answered_by(self, message: Message) -> bool:
        """Whether `message`, which has the right id, is of the kind that answers this."""
        if message.name in ("ACK", "NACK"):
            good = message.int("command") == BY_NAME[self.name].type
            return good and (message.name == "NACK" or self.name not in ANSWERS)
        if message.name == "CAPTURE_BLOCK" and self.values.get("index") != message.int("index"):
            return False
        return ANSWERS.get(self.name) == message.name


class SendQueue:
    """What is to be written next: the frames of commands in order, a STOP first."""

    def __init__(self) -> None:
        self._due: deque[Command] = deque()
        self._writer: Command | None = None  # whose frame was begun
        self._rest = b""  # of that frame

    def clear(self) -> None:
        """A fresh connection: nothing is due, nothing was begun."""
        self._due.clear()
        self._rest = b""

    def output(self) -> bytes:
        """One frame, or the rest of it; nothing where b""."""
        if self._rest:
            return self._rest
        return self._due[0].frame if self._due else b""

    def wrote(self, count: int) -> None:
        """The port has taken this many bytes of `output`."""
        if not self._rest and count:
            self._writer = self._due.popleft()
            self._writer.attempts += 1
            self._rest = self._writer.frame
        self._rest = self._rest[count:]

    def take(self) -> bytes:
        """All of it, for a port that takes everything."""
        taken = bytearray()
        while data := self.output():
            taken += data
            self.wrote(len(data))
        return bytes(taken)

    def add(self, command: Command) -> None:
        """It is to be written, if it does not wait for that already."""
        if command in self._due:
            return
        if command.name == "STOP":
            self._due.appendleft(command)
        else:
            self._due.append(command)

    def withdraw(self, command: Command) -> None:
        """It need not be written again; a STOP that is to be is, whatever became of it."""
        if command in self._due and command.name != "STOP":
            self._due.remove(command)

    def drop(self, command: Command) -> None:
        """It must not act any more."""
        self.withdraw(command)
        if command is self._writer and command.name != "STOP":
            self._rest = b""

    def spare(self, stop: Command) -> None:
        """A STOP that was given up need not go out where another one does."""
        if stop in self._due and sum(c.name == "STOP" for c in self._due) > 1:
            self._due.remove(stop)
