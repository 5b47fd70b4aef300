"""Answers to commands, kept for their repetitions: rule 3 of protocol/README.md."""

from __future__ import annotations

from collections import deque

from gateway.emulator.firmware_model.commands import Nack
from gateway.emulator.firmware_model.uart import Outbox, Priority
from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, Message, Reason

RETAINED_IDS = 8


class Answers:
    """The answers to commands, of which the newest are kept."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._retained: deque[tuple[int, int, bytes, Priority]] = deque(maxlen=RETAINED_IDS)  # id, type, frame

    def forget(self) -> None:
        """Forget the retained answers, as a new session does."""
        self._retained.clear()

    def has_room(self, body: bytes) -> bool:
        """Return whether an answer to this command would not be lost."""
        blocks = body[0] == ROW_OF_NAME["READ_CAPTURE"].type and self._outbox.full(Priority.CAPTURE_BLOCK)
        return not self._outbox.full(Priority.ANSWER) and not blocks

    def put(self, body: bytes, answer: Message | Nack, *, keep: bool = True) -> None:
        """Answer a command."""
        if isinstance(answer, Nack):
            answer = Message("NACK", {"command": body[0], "reason": int(answer.reason), "detail": answer.detail})
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
