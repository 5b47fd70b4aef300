"""The commands to one board, from their submission to their answer.  No I/O, no clock.

Rule 1: one command is outstanding; the others wait in order.  STOP does not wait: it is sent at once.  It
        cancels the waiting commands that could move the ball: a command given before STOP must not act after it.
Rule 2: a command is repeated with the same id, at most `retries` times.  Every submitted command ends in exactly one
        `Answer`, also when the board restarts or the connection ends.  STOPs that share a token share one `Answer`.
Rule 3: frames do not wait in a buffer of bytes.  `SendQueue.output` gives one at a time, when the port has room.  A
        command that was given up or cancelled is not sent.  If its frame is partly written, the rest is dropped, and
        the board rejects the part by its CRC.  A STOP is sent even after it was given up: a late STOP is harmless.
Rule 4: a pipe may accept frames that the board reads much later.  A command that changes something is therefore sent
        only if the board has answered within PROVEN_S and no command was given up since; otherwise a PING is sent
        first.  A command that was not begun within its `wait_s` is given up with 0 attempts: it has not acted and
        never will.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from protocol.wire.codec import encode_body
from protocol.wire.events import Answer, Event, Outcome
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, VERSION, Message, Value

MOVERS = frozenset({"SET_MODE", "SET_REFERENCE", "SET_GAINS", "EXCITE", "CAPTURE"})
WAIT_S = 2.0  # a command that cannot be sent within this time is given up: its sender no longer expects it to act
PROVEN_S = 0.5  # twice the time between two PINGs at the default host-loss time-out
MAX_STOPS = 8  # unanswered at a time: more would fill the line with STOPs and delay the answers
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


class CommandExchange:
    """The base of `Session`: it numbers, sends, repeats and answers commands."""

    def __init__(self, *, timeout_s: float, retries: int, hello_s: float, first_id: int) -> None:
        self.is_open = False  # after the handshake; only STOP and HELLO are sent before
        self.deadline_s = float("inf")  # when `poll` has something to do
        self._timeout_s, self._retries, self._hello_s = timeout_s, retries, hello_s
        self._sending = SendQueue()
        self._queue: deque[Command] = deque()
        self._outstanding: dict[int, Command] = {}  # at most one command, and STOPs
        self._hello: Command | None = None
        self._next_id = first_id
        self._next_token = 0
        self._proven_s = -math.inf  # the board has answered
        self._pending: list[Event] = []  # outcomes that occurred outside `feed` and `poll`

    @property
    def waiting(self) -> int:
        """The number of commands that are not answered yet."""
        return len(self._queue) + len(self._outstanding)

    def submit(self, name: str, now_s: float, wait_s: float = WAIT_S, /, **values: Value) -> int:
        """Queue a command and return its token; it waits for the handshake, STOP does not.

        While MAX_STOPS are not answered, and repeated until they are, further STOPs share the STOP after them, and
        its token.  A command is given up where it cannot begin to go out within `wait_s`.

        Raises:
            ValueError: a value is out of the range of its field.
        """
        encode_body(name, id=1, **values)  # refuse invalid values before queueing
        if name == "STOP":
            # Only what could move the ball: a question or the rate of the stream does no harm after a STOP.
            self._cancel(lambda c: c.name in MOVERS, "stop")
            shared = next((c for c in self._queue if c.name == "STOP"), None)
            # Shared, not sent as well: more STOPs would fill the line and delay the answers.
            if shared is not None:
                return shared.token
        self._next_token += 1
        command = Command(self._next_token, name, values, deadline_s=now_s + min(wait_s, WAIT_S))
        self._queue.append(command)
        self._pump(now_s)
        return command.token

    def output(self) -> bytes:
        """Return the next bytes for the UART: one frame, or the rest of one; b"" if there is none."""
        return self._sending.output()

    def wrote(self, count: int) -> None:
        """Note that the port has accepted `count` bytes of `output`."""
        self._sending.wrote(count)

    def take_outcomes(self) -> list[Event]:
        """Return the outcomes of commands that ended within `submit`, because a STOP cancelled them."""
        pending, self._pending = self._pending, []
        return pending

    def poll(self, now_s: float) -> list[Event]:
        """Repeat or give up commands that were not answered in time."""
        if self._hello is not None and now_s >= self._hello.deadline_s:
            self._transmit(self._hello, now_s, self._hello_s)
        for command in list(self._outstanding.values()):
            if now_s < command.deadline_s:
                continue
            if command.tries > self._retries:
                del self._outstanding[command.id]
                self._sending.drop(command)
                self._sending.spare(command)
                # A board that did not answer has to prove itself again: the line may hold frames that it reads much
                # later.
                self._proven_s = -math.inf
                self._answer(command, "timed-out")
            else:
                # With the same id: the board repeats its answer, and does not execute the command twice.
                self._transmit(command, now_s, self._timeout_s)
        for command in [c for c in self._queue if now_s >= c.deadline_s]:
            self._queue.remove(command)
            self._answer(command, "timed-out")
        self._pump(now_s)
        return self.take_outcomes()

    def _call(self, session: int, now_s: float) -> None:
        """Send HELLO at the next `poll`, until it is answered."""
        if self._hello is not None:
            self._sending.withdraw(self._hello)
        values: dict[str, Value] = {"session": session, "version_min": VERSION, "version_max": VERSION}
        self._hello = Command(0, "HELLO", values, deadline_s=now_s)
        self._hello.number(self._free_id())
        self.deadline_s = now_s

    def _match(self, message: Message) -> Command | None:
        """Return the command that a message of the board answers."""
        for command in (self._hello, self._outstanding.get(message.int("id"))):
            if command is not None and command.id == message.int("id") and command.accepts_answer(message):
                return command
        return None

    def _conclude(self, command: Command, message: Message, now_s: float) -> None:
        """End a command that the board has answered."""
        if command is self._hello:
            self._hello = None
        else:
            del self._outstanding[command.id]
        self._sending.withdraw(command)
        self._proven_s = now_s
        self._answer(command, "nack" if message.name == "NACK" else "ack", message)

    def _pump(self, now_s: float) -> None:
        stops = sum(c.name == "STOP" for c in self._outstanding.values())
        if stops < MAX_STOPS:
            for stop in [c for c in self._queue if c.name == "STOP"]:
                self._queue.remove(stop)
                self._send(stop, now_s)
        queued = [c for c in self._queue if c.name != "STOP"]
        if self.is_open and queued and not any(c.name != "STOP" for c in self._outstanding.values()):
            # An answer is the proof, not the kernel's output queue: a pty reports an empty one with bytes in it.
            proven = now_s - self._proven_s <= PROVEN_S
            # Without a proof only questions are sent: they change nothing if the board reads them late.
            following = next((c for c in queued if proven or c.name in ANSWERS), None)
            if following is not None:
                self._queue.remove(following)
            self._send(following or Command(0, "PING", {}), now_s)
        self._set_deadline()

    def _send(self, command: Command, now_s: float) -> None:
        command.number(self._free_id())
        self._outstanding[command.id] = command
        self._transmit(command, now_s, self._timeout_s)
        self._set_deadline()

    def _transmit(self, command: Command, now_s: float, timeout_s: float) -> None:
        command.tries += 1
        command.deadline_s = now_s + timeout_s
        self._sending.add(command)

    def _free_id(self) -> int:
        used_ids = self._outstanding.keys() | ({self._hello.id} if self._hello else set())
        while True:
            self._next_id = self._next_id % 255 + 1
            # An id under way is skipped: the answer to the one command would end the other.
            if self._next_id not in used_ids:
                return self._next_id

    def _answer(self, command: Command, outcome: Outcome, message: Message | None = None, why: str = "") -> None:
        if command.token:
            self._pending.append(Answer(command.token, outcome, command.attempts, message, why))

    def _cancel(self, which: Callable[[Command], bool], why: str) -> None:
        for command in [*self._outstanding.values(), *self._queue]:
            if which(command):
                self._outstanding.pop(command.id, None)
                self._sending.drop(command)
                self._answer(command, "cancelled", why=why)
        self._queue = deque(c for c in self._queue if not which(c))

    def _set_deadline(self) -> None:
        deadlines = [c.deadline_s for c in (*self._outstanding.values(), *self._queue)]
        if self._hello is not None:
            deadlines.append(self._hello.deadline_s)
        self.deadline_s = min(deadlines, default=float("inf"))
