"""A simulated ATmega328P on a bench, for tests: a host at its UART, readings that the test sets, its cycles counted."""

from __future__ import annotations

import pytest

from firmware.sim.avr.board import AvrBoard
from firmware.sim.avr.build import missing
from gateway.emulator.firmware_model.board import AnalogSide
from protocol.wire.decoder import BadFrame, State, StreamDecoder
from protocol.wire.messages import EventCode, Message, Value
from tests.harness.gateway.board_host import Bench, frame
from tests.harness.protocol.port import take_output

_LONGEST_WAIT = 400  # ticks


def skip_without_avr() -> None:
    absent = missing()
    if absent is not None:
        pytest.skip(f"the simulated AVR needs avr-gcc and libsimavr (Debian: libsimavr-dev), and {absent} is not there")


class AvrHost:
    """Sends commands to a chip and sorts what comes back; `cycles` has those of each tick in which it was awake."""

    def __init__(self, plant: AnalogSide | None = None, *, board: AvrBoard | None = None) -> None:
        self.plant = Bench() if plant is None else plant
        self.board = AvrBoard(self.plant) if board is None else board
        self.states: list[State] = []
        self.messages: list[Message] = []
        self.cycles: list[int] = []
        self.bad_frames = 0
        self._decoder = StreamDecoder()
        self._id = 0

    def run(self, ticks: int = 1) -> None:
        """Let ticks pass."""
        for _ in range(ticks):
            before = self.board.cycles_awake
            self.board.tick()
            self.cycles.append(self.board.cycles_awake - before)
            for event in self._decoder.feed(take_output(self.board)):
                if isinstance(event, BadFrame):
                    self.bad_frames += 1  # cut off by a reset
                elif isinstance(event, State):
                    self.states.append(event)
                else:
                    self.messages.append(event)

    def until(self, code: EventCode) -> Message:
        """Let ticks pass until this event; return it."""
        seen = len(self.messages)
        for _ in range(_LONGEST_WAIT):
            self.run()
            for message in self.messages[seen:]:
                if message.name == "EVENT" and message.int("code") == code:
                    return message
        raise AssertionError(f"no {code.name} in {_LONGEST_WAIT} ticks: {self.messages[seen:]}")

    def send(self, name: str, /, **fields: Value) -> int:
        """Send a command, without waiting; return its id."""
        self._id = self._id % 255 + 1
        self.board.feed(frame(name, id=self._id, **fields), into_tick_us=0)
        return self._id

    def ask(self, name: str, /, **fields: Value) -> Message:
        """Send a command and wait for its answer."""
        number, seen = self.send(name, **fields), len(self.messages)
        for _ in range(_LONGEST_WAIT):
            self.run()
            for message in self.messages[seen:]:
                if message.name != "EVENT" and message.int("id") == number:
                    return message
        raise AssertionError(f"no answer to {name} in {_LONGEST_WAIT} ticks")

    def hello(self) -> Message:
        """Open a session."""
        return self.ask("HELLO", session=1, version_min=1, version_max=1)

    def codes(self) -> list[EventCode]:
        """The events so far, in order."""
        return [EventCode(message.int("code")) for message in self.messages if message.name == "EVENT"]
