"""A host at the firmware's elbow, for tests: frames straight in, events straight out, no line between."""

from __future__ import annotations

from typing import ClassVar

import pytest

from gateway.emulator.firmware_model.board import AnalogSide, Firmware
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.native.build import compiler
from protocol.wire.codec import encode_body
from protocol.wire.decoder import BadFrame, Event, State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import EventCode, Message, Value
from tests.harness.protocol.port import take_output

SECOND = 500  # ticks
QUIET = {"amplitude": 0, "period": 1, "period_end": 1, "seed": 1, "duration": 0}
FIRMWARES: dict[str, type[Firmware] | type[NativeFirmware]] = {"python": Firmware, "c": NativeFirmware}


def skip_without_compiler() -> None:
    if compiler() is None:
        pytest.skip("the firmware in C needs a C compiler, and there is none")


class Bench(AnalogSide):
    """Converters on a bench: fixed readings, and a record of the input: (u in V, for how long in us)."""

    def __init__(self, *, i_a: float = 0.0, x_m: float = 2.85e-3) -> None:
        self.i_a = i_a
        self.x_m = x_m
        self.inputs: list[tuple[float, int]] = []
        self.lossy = False

    def advance(self, u_v: float, duration_s: float) -> None:
        self.inputs.append((u_v, round(duration_s * 1e6)))

    def sense(self) -> tuple[float, float]:
        return self.i_a, self.x_m

    def drop_sample(self) -> bool:
        return self.lossy


def frame(name: str, /, **fields: Value) -> bytes:
    """A command as bytes."""
    return encode_frame(encode_body(name, **fields))


class Host:
    """Sends commands with fresh ids and sorts what comes back."""

    make: ClassVar[type[Firmware] | type[NativeFirmware]] = Firmware  # the fixture each_firmware changes it

    def __init__(
        self,
        plant: AnalogSide | None = None,
        *,
        session: bool = True,
        board: Firmware | NativeFirmware | None = None,
    ) -> None:
        self.plant = Bench() if plant is None else plant
        self.firmware = self.make(self.plant) if board is None else board
        self.states: list[State] = []
        self.events: list[Message] = []
        self.answers: list[Message] = []
        self._decoder = StreamDecoder()
        self._id = 0
        if session:
            assert self.hello(1).name == "IDENTITY"

    def next_id(self) -> int:
        self._id = self._id % 255 + 1
        return self._id

    def hello(self, session: int, *, version_min: int = 1, version_max: int = 1) -> Message:
        return self.request("HELLO", session=session, version_min=version_min, version_max=version_max)

    def run(self, ticks: int, *, alive: bool = True) -> list[State]:
        """Let ticks pass; a host that is alive pings now and then, so that the board does not miss it."""
        states: list[State] = []
        for n in range(ticks):
            if alive and n % 100 == 99:
                self.firmware.feed(frame("PING", id=self.next_id()))
            self.firmware.tick()
            states += self.collect()
        return states

    def collect(self) -> list[State]:
        return self.sort(self._decoder.feed(take_output(self.firmware)))

    def sort(self, received: list[Event]) -> list[State]:
        states: list[State] = []
        for event in received:
            assert not isinstance(event, BadFrame), event
            if isinstance(event, State):
                states.append(event)
            elif event.name == "EVENT":
                self.events.append(event)
            elif event.name != "PONG":
                self.answers.append(event)
        self.states += states
        return states

    def request(self, name: str, /, **fields: Value) -> Message:
        """Send one command, let one tick pass, and return the answer."""
        return self.send(frame(name, id=self.next_id(), **fields))

    def send(self, data: bytes) -> Message:
        """Send one frame, let one tick pass, and return the answer."""
        before = len(self.answers)
        self.firmware.feed(data)
        self.run(1, alive=False)
        assert len(self.answers) == before + 1, self.answers[before:]
        return self.answers[-1]

    def codes(self) -> list[EventCode]:
        """The events so far, in order."""
        return [EventCode(event.int("code")) for event in self.events]

    def details(self, code: EventCode) -> list[int]:
        """The details of the events of one code."""
        return [event.int("detail") for event in self.events if event.int("code") == code]


def refusal(answer: Message) -> tuple[int, int]:
    """(reason, detail) of a NACK."""
    assert answer.name == "NACK", answer
    return answer.int("reason"), answer.int("detail")


def open_loop(u: int, bench: Bench | None = None) -> Host:
    """A host with the board in open loop at a constant input."""
    host = Host(bench)
    host.request("SET_MODE", mode=1)
    host.request("EXCITE", shape=0, target=0, offset=u, **QUIET)
    return host
