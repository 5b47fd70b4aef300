"""The board at the other end of a `Wire`: orders and answers, samples and events; one thread, `protocol`'s session.

Rule 1: a PING every 0.1 s shows the board that the host is there, unless `silent` is set.
Rule 2: nothing here moves the ball; `switch_off` sends STOP.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable

from gateway.selftest.wire import Wire
from protocol.errors import ServiceError
from protocol.wire.codec import unpack_counts
from protocol.wire.events import Answer, BoardEvent, Event, Opened, Restarted, Sample, VersionRefused
from protocol.wire.messages import Message, Reason, Value
from protocol.wire.session import Session

PING_S = 0.1
ANSWER_S = 2.0  # longer than all repetitions of the session: 5 times 0.1 s
BOOT_S = 8.0  # a boot loader of an Uno takes up to 2 s, and opening the port starts it


class NoAnswerError(ServiceError):
    """The board did not answer, restarted, or its port is gone."""


class RefusedError(ServiceError):
    """The board refused a command that the interface allows here."""


class Connection:
    """A session with one board."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.session = Session(choose_session=lambda: secrets.randbits(16))
        self.samples: list[Sample] = []
        self.events: list[BoardEvent] = []
        self.identities: list[tuple[float, Message]] = []  # when, what; one for each handshake
        self.version_refused: int | None = None  # the board's
        self.restarts = 0  # of the board, seen by its ticks or its forgotten session
        self.bytes_received = 0
        self._answers: dict[int, Answer] = {}
        self._next_ping_s = 0.0

    def open(self, patience_s: float = BOOT_S) -> bool:
        """Start the handshake; return whether the board answered."""
        self.session.connect(self.wire.now_s())
        return self.until(lambda: self.session.is_open or self.version_refused is not None, patience_s)

    def switch_off(self) -> bool:
        """Send STOP; return whether a state after it shows u_c at 0.  Never raises."""
        try:
            if self.stop() is None or not self.until(lambda: self.session.is_open, 1.0):
                return False
            first = len(self.samples)
            self.run(0.05)
        except ServiceError:
            return False
        return len(self.samples) > first and self.samples[-1].state.u_c == 0

    def stop(self) -> Message | None:
        """Send STOP; return its ACK, or None after 1 s."""
        token = self.session.submit("STOP", self.wire.now_s())
        self.until(lambda: token in self._answers, 1.0)
        answer = self._answers.pop(token, None)
        return answer.message if answer is not None and answer.outcome == "ack" else None

    def step(self, timeout_s: float, *, silent: bool = False) -> None:
        """Write what is due, wait for bytes for at most `timeout_s`, and read them.

        Raises:
            NoAnswerError: the port is gone.
        """
        now_s = self.wire.now_s()
        if not silent and self.session.is_open and now_s >= self._next_ping_s:
            self._next_ping_s = now_s + PING_S
            if not self.session.waiting:
                self.session.submit("PING", now_s)
        if now_s >= self.session.deadline_s:
            self._note(self.session.poll(now_s))
        self._write()
        next_s = self.session.deadline_s if silent else min(self.session.deadline_s, self._next_ping_s)
        if not self.session.is_open:
            next_s = min(next_s, now_s + PING_S)
        if not self.wire.wait(max(0.0, min(timeout_s, next_s - now_s))):
            return  # a tty without bytes reads as one that is lost
        data = self.wire.read()
        if data == b"":
            raise NoAnswerError("The port is gone", remedy="Look at the plug and at dmesg, and repeat")
        if data:
            self.bytes_received += len(data)
            self._note(self.session.feed(data, self.wire.now_s()))
            self._write()

    def run(self, duration_s: float, *, silent: bool = False) -> list[Sample]:
        """Run for `duration_s`; return the samples of that time."""
        first, end_s = len(self.samples), self.wire.now_s() + duration_s
        while (left_s := end_s - self.wire.now_s()) > 0.0:
            self.step(left_s, silent=silent)
        return self.samples[first:]

    def until(self, condition: Callable[[], bool], patience_s: float) -> bool:
        """Run until the condition holds; return whether it does within `patience_s`."""
        end_s = self.wire.now_s() + patience_s
        while not condition():
            left_s = end_s - self.wire.now_s()
            if left_s <= 0.0:
                return False
            self.step(left_s)
        return True

    def send(self, name: str, /, **values: Value) -> Answer:
        """Send a command and return its outcome.

        Raises:
            NoAnswerError: there is none, or the board restarted.
        """
        token = self.session.submit(name, self.wire.now_s(), **values)
        if not self.until(lambda: token in self._answers, ANSWER_S):
            raise NoAnswerError(f"The board does not answer {name}", remedy="Look at the line to it: RX, ground, baud")
        answer = self._answers.pop(token)
        if answer.outcome in ("timed-out", "cancelled"):
            why = "restarted" if answer.why == "board-reset" else "did not answer"
            raise NoAnswerError(f"The board {why} at {name}", remedy="Look at its supply and at the line to it")
        return answer

    def order(self, name: str, /, **values: Value) -> Message:
        """Send a command and return the board's answer.

        Raises:
            NoAnswerError: as of `send`.
            RefusedError: the board refused it.
        """
        message = self.send(name, **values).message
        if message is None or message.name == "NACK":
            reason = "?" if message is None else Reason(message.int("reason")).name
            problem = f"The board refuses {name}: {reason}"
            raise RefusedError(problem, remedy="Compare its firmware with protocol/README.md")
        return message

    def read_capture(self) -> list[int]:
        """Read the counts of i_c of the last capture.

        Raises:
            NoAnswerError, RefusedError: as of `order`.
        """
        counts: list[int] = []
        total = 1
        while len(counts) < total:
            block = self.order("READ_CAPTURE", index=len(counts))
            total = block.int("total")
            counts += unpack_counts(block.bytes("samples"))[: total - len(counts)]
        return counts

    def _write(self) -> None:
        while data := self.session.output():
            written = self.wire.write(data)
            if written is None:
                raise NoAnswerError("The port is gone", remedy="Look at the plug and at dmesg, and repeat")
            self.session.wrote(written)
            if written < len(data):
                return

    def _note(self, events: list[Event]) -> None:
        for event in events:
            match event:
                case Sample():
                    self.samples.append(event)
                case Answer():
                    self._answers[event.token] = event
                case BoardEvent():
                    self.events.append(event)
                case Opened():
                    self.identities.append((self.wire.now_s(), event.identity))
                case VersionRefused():
                    self.version_refused = event.board_version
                case Restarted():
                    self.restarts += event.board_reset
