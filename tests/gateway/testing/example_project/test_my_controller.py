"""Code that talks to the board's UART itself, tested in lockstep: the same answer on every machine and every run."""

from __future__ import annotations

import pytest
import serial

from gateway.testing import EmulatorFactory
from protocol.errors import ServiceError
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import Message


class MyController:
    """The subject of this project: a controller that lifts the ball through a serial port of its own."""

    def __init__(self, port: serial.Serial) -> None:
        self.port, self.decoder, self.states, self.answers = port, StreamDecoder(), list[State](), list[Message]()
        self.number = 0

    def send(self, name: str, **fields: int) -> None:
        self.number = self.number % 255 + 1
        self.port.write(encode_frame(encode_body(name, id=self.number, **fields)))

    def read(self) -> None:
        for event in self.decoder.feed(self.port.read(65536)):
            (self.states if isinstance(event, State) else self.answers).append(event)  # type: ignore[arg-type]  # one of two lists


def lift(controller: MyController, advance: object) -> None:
    assert callable(advance)
    controller.send("HELLO", session=7, version_min=1, version_max=1)
    for _ in range(2):
        advance(0.02)
        controller.read()
    controller.send("SET_MODE", mode=2)
    for n in range(100):
        advance(0.02)
        controller.read()
        if n % 10 == 0:
            controller.send("PING")


def flight(board51_emulator: EmulatorFactory, **options: object) -> list[State]:
    emulator = board51_emulator(lockstep=True, **options)  # type: ignore[arg-type]  # options of any type
    with serial.serial_for_url(emulator.urls[0], timeout=0) as port:
        controller = MyController(port)
        lift(controller, emulator.advance)
        assert emulator.counts().time_s == pytest.approx(2.04)
    assert "NACK" not in [message.name for message in controller.answers]
    return controller.states


@pytest.mark.parametrize("port", ["tcp", "pty"])
def test_my_controller_lifts_the_ball(board51_emulator: EmulatorFactory, port: str) -> None:
    states = flight(board51_emulator, port=port)

    assert len(states) > 900
    assert states[-1].x > states[0].x


def test_the_same_flight_twice(board51_emulator: EmulatorFactory) -> None:
    first, second = (flight(board51_emulator, effects={"quadratic-drag": 1.0}, seed=3) for _ in range(2))

    assert first == second


def test_a_host_that_does_not_read_is_told(board51_emulator: EmulatorFactory) -> None:
    emulator = board51_emulator(lockstep=True, port="pty")
    with serial.serial_for_url(emulator.urls[0], timeout=0) as port:
        MyController(port).send("HELLO", session=7, version_min=1, version_max=1)
        with pytest.raises(ServiceError, match="has lost"):
            emulator.advance(20.0)
