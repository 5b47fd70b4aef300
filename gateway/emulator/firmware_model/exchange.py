"""Commands that wait for their execution, and answers kept for repetitions: rules 3, 4 and 13 of protocol/README.md."""

from __future__ import annotations

from collections import deque

from gateway.emulator.firmware_model.commands import Acceptance, Nack
from gateway.emulator.firmware_model.uart import Outbox, Priority
from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, Message, Reason

RETAINED_IDS = 8
PENDING_COMMANDS = 8
COMMANDS_PER_TICK = 1


class CommandQueue:
    """The commands that wait, as (body, what the decoder made of it)."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[bytes, Message | Nack]] = deque()
        self._overtaken = 0  # of them, the first, by a STOP
        self._budget = COMMANDS_PER_TICK

    def begin_tick(self) -> None:
        """Allow the commands of the next tick."""
        self._budget = COMMANDS_PER_TICK

    def overtake(self) -> None:
        """Note that a STOP has overtaken all that wait."""
        self._overtaken = len(self._waiting)

    def add(self, body: bytes, command: Message | Nack) -> bool:
        """Let a command wait; return whether there was room."""
        if len(self._waiting) >= PENDING_COMMANDS:
            return False
        self._waiting.append((body, command))
        return True

    @property
    def due(self) -> bytes:
        """The body of the command that may be executed now, or b""."""
        return self._waiting[0][0] if self._waiting and self._budget else b""

    def take(self) -> tuple[bytes, Message | Nack, bool]:
        """Return the first command, and whether a STOP has overtaken it."""
        is_overtaken = self._overtaken > 0
        self._overtaken = max(self._overtaken - 1, 0)
        self._budget -= 1
        return *self._waiting.popleft(), is_overtaken


class Answers:
    """The answers to commands, of which the newest are kept."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._retained: deque[tuple[int, int, bytes, Priority]] = deque(maxlen=RETAINED_IDS)  # id, type, frame

    def forget(self) -> None:
        """Forget what was kept, as a new session does."""
        self._retained.clear()

    def has_room(self, body: bytes) -> bool:
        """Return whether an answer to this command would not be lost."""
        blocks = body[0] == ROW_OF_NAME["READ_CAPTURE"].type and self._outbox.full(Priority.CAPTURE_BLOCK)
        return not self._outbox.full(Priority.ANSWER) and not blocks

    def put(self, body: bytes, answer: Acceptance | Nack, *, keep: bool = True) -> None:
        """Answer a command."""
        if isinstance(answer, Nack):
            values = {"command": body[0], "reason": int(answer.reason), "detail": answer.detail}
            answer = Acceptance("NACK", values)
        frame = encode_frame(encode_body(answer.name, id=body[1], **answer.values))
        priority = Priority.CAPTURE_BLOCK if answer.name == "CAPTURE_BLOCK" else Priority.ANSWER
        if keep:
            self._retained = deque((entry for entry in self._retained if entry[0] != body[1]), maxlen=RETAINED_IDS)
            self._retained.append((body[1], body[0], frame, priority))
        self._outbox.put(frame, priority)

    def repeat(self, body: bytes) -> bool:
        """Answer a command whose id is kept, without executing it; return whether it is."""
        retained = next((entry for entry in self._retained if entry[0] == body[1]), None)
        if retained is None:
            return False
        if retained[1] == body[0]:
            self._outbox.put(retained[2], retained[3])
        else:
            self.put(body, Nack(Reason.BUSY), keep=False)
        return True
