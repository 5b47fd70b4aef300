"""A host at the UART of a simulated chip, for tests: an answer comes some ticks after its command."""

from __future__ import annotations

from typing import Generic, TypeVar

from firmware.sim.avr.board import AvrBoard
from firmware.sim.mcs51.board import Mcs51Board
from protocol.wire.decoder import BadFrame, State, StreamDecoder
from protocol.wire.messages import EventCode, Message, Value
from tests.harness.gateway.board_host import frame
from tests.harness.protocol.port import take_output

ChipBoard = TypeVar("ChipBoard", AvrBoard, Mcs51Board)
_LONGEST_WAIT = 400  # ticks


class ChipHost(Generic[ChipBoard]):
    """Sends commands to a chip and sorts what comes back."""

    def __init__(self, board: ChipBoard) -> None:
        self.board: ChipBoard = board
        self.states: list[State] = []
        self.messages: list[Message] = []
        self.bad_frames = 0
        self._decoder = StreamDecoder()
        self._id = 0

    def run(self, ticks: int = 1) -> None:
        """Let ticks pass."""
        for _ in range(ticks):
            self.board.tick()
            for event in self._decoder.feed(take_output(self.board)):
                if isinstance(event, BadFrame):
                    self.bad_frames += 1  # cut off by a reset
                elif isinstance(event, State):
                    self.states.append(event)
                else:
                    self.messages.append(event)

    def until(self, code: EventCode) -> Message:
        """Let ticks pass until this event; return it."""
        start = len(self.messages)
        for _ in range(_LONGEST_WAIT):
            self.run()
            for message in self.messages[start:]:
                if message.name == "EVENT" and message.int("code") == code:
                    return message
        raise AssertionError(f"no {code.name} in {_LONGEST_WAIT} ticks: {self.messages[start:]}")

    def ticks_until_off(self, *, max_ticks: int) -> int:
        """Let ticks pass until u_c is 0; return how many."""
        for n in range(1, max_ticks + 1):
            self.run()
            if self.board.u == 0:
                return n
        raise AssertionError(f"u_c is {self.board.u} after {max_ticks} ticks")

    def send(self, name: str, /, **fields: Value) -> int:
        """Send a command, without waiting; return its id."""
        self._id = self._id % 255 + 1
        self.board.feed(frame(name, id=self._id, **fields))
        return self._id

    def request(self, name: str, /, **fields: Value) -> Message:
        """Send a command and wait for its answer."""
        start, number = len(self.messages), self.send(name, **fields)
        for _ in range(_LONGEST_WAIT):
            self.run()
            for message in self.messages[start:]:
                if message.name != "EVENT" and message.int("id") == number:
                    return message
        raise AssertionError(f"no answer to {name} in {_LONGEST_WAIT} ticks")

    def hello(self) -> Message:
        """Open a session."""
        return self.request("HELLO", session=1, version_min=1, version_max=1)

    def codes(self) -> list[EventCode]:
        """The events so far, in order."""
        return [EventCode(message.int("code")) for message in self.messages if message.name == "EVENT"]

    def the_event(self, code: EventCode) -> Message:
        """The only event of a code."""
        (event,) = [m for m in self.messages if m.name == "EVENT" and m.int("code") == code]
        return event
