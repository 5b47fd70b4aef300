"""The chip against the core on this machine, compiled with the chip's options: the same commands and readings give the
same frames and the same input of the coil.

The chip's line takes time, so a command is written ahead but for its last byte, which comes to both between the same
two ticks; and what is compared is each kind of frame in its order.  The readings are those that 10 bits hold.  RESET
and CAPTURE, whose times are not those of ticks, have tests of their own.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from firmware.sim.avr.board import ADC_BITS, AvrBoard
from gateway.emulator.firmware_model.flash import CURRENT, POSITION
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.native.build import compile_to
from gateway.emulator.native.flags import flags
from protocol.wire.decoder import BadFrame, Event, State, StreamDecoder
from protocol.wire.messages import ROW_OF_TYPE, EventCode, Message
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.random_host import Script
from tests.harness.gateway.board_host import Bench, frame
from tests.harness.protocol.port import take_output

TICKS = 6000
SPACING = 14  # ticks between two commands: the longest answer has left by then
PER_TICK = 20  # bytes that the line brings in a tick


@pytest.fixture(scope="module")
def small_core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The core with the chip's queues and capture, for this machine."""
    skip_without_avr()
    path: Path = tmp_path_factory.mktemp("small") / "firmware.so"
    compile_to(path, options=flags("AVR_CONFIG"))
    return path


class Pair:
    """The two boards at one host, run tick by tick."""

    def __init__(self, path: Path) -> None:
        self.plants = Bench(), Bench()
        self.chip = AvrBoard(self.plants[0])
        self.core = NativeFirmware(self.plants[1], path=path)
        self._decoders = StreamDecoder(), StreamDecoder()
        self.chip_events: list[Event] = []
        self.core_events: list[Event] = []
        self.read(300, 500)
        self.chip.feed(b"", into_tick_us=1000)  # so that its ticks fall into the middle of those of the test
        self.chip.reset(EventCode.RESET_POWER_ON)
        while self.chip.next_tick != 1:
            self.chip.tick()
        self.core.tick()
        self._take()

    def read(self, i: int, x: int) -> None:
        """Let both converters show these numbers of 10 bits from now on."""
        for plant in self.plants:
            plant.i_a, plant.x_m = CURRENT.to_si(i << 2 | i >> 8), POSITION.to_si(x << 2 | x >> 8)

    def tick(self, data: bytes = b"") -> None:
        """`data`, then one tick of both."""
        self.chip.feed(data)
        self.chip.tick()
        self.core.feed(data)
        self.core.tick()
        self._take()

    def send(self, data: bytes) -> None:
        """A frame: its end comes to both before the same tick."""
        for at in range(0, len(data) - 1, PER_TICK):
            self.tick(data[at : min(at + PER_TICK, len(data) - 1)])
        self.tick(data[-1:])

    def drain(self) -> None:
        """Let the chip's last frame leave, before its next tick."""
        self.chip.feed(b"", into_tick_us=900)
        self._take()

    def _take(self) -> None:
        self.chip_events += self._decoders[0].feed(take_output(self.chip))
        self.core_events += self._decoders[1].feed(take_output(self.core))


OF_THE_CHIP = {"adc_bits", "build", "stack_free", "u_power_on"}


@dataclass
class Kinds:
    """Each kind of frame in its order; resolution of the converters, build, stack and converter are the chip's."""

    states: list[State] = field(default_factory=list)
    events: list[Message] = field(default_factory=list)
    answers: list[Message] = field(default_factory=list)

    @classmethod
    def of(cls, received: list[Event]) -> Kinds:
        kinds = cls()
        for event in received:
            assert not isinstance(event, BadFrame), event
            if isinstance(event, State):
                kinds.states.append(event)
            elif event.name == "EVENT":
                kinds.events.append(event)
            else:
                values = {name: value for name, value in event.values.items() if name not in OF_THE_CHIP}
                kinds.answers.append(replace(event, values=values))
        return kinds

    def names(self) -> list[str]:
        """Return the names of the answers."""
        return [answer.name for answer in self.answers]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_same_commands_and_readings_give_the_same_frames(seed: int, small_core: Path) -> None:
    pair, script, chance = Pair(small_core), Script(seed), random.Random(seed)
    i = x = 512
    inputs: list[tuple[int, int]] = []
    for n in range(TICKS // SPACING):
        for _ in range(SPACING):
            stuck = n % 100 in range(80, 85)  # at an end, long enough for OVER_CURRENT
            i = 1023 if stuck else min(max(i % 1023 + chance.randint(-20, 20), 0), 1022)
            x = min(max(x + chance.randint(-30, 30), 0), 1023)
            coil_off = pair.core.u == 0 and not stuck and n % 50 != 0  # else it is a fault most of the time
            pair.read(min(i, 100) if coil_off else i, x)
            pair.tick()
            inputs.append((pair.chip.u, pair.core.u))
        pair.send(command(script))
    for _ in range(SPACING):
        pair.tick()

    pair.drain()
    chip, core = Kinds.of(pair.chip_events), Kinds.of(pair.core_events)
    assert (pair.chip.dropped, pair.core.dropped) == (0, 0)
    assert chip.answers == core.answers
    assert chip.events == core.events
    assert chip.states == core.states
    assert all(a == b for a, b in inputs)
    assert len({u for u, _ in inputs}) > 50
    assert len(core.states) > TICKS // 4
    assert len(set(core.names())) > 3
    assert pair.chip.bad_frames == pair.core.bad_frames


def test_a_capture_holds_the_same_samples(small_core: Path) -> None:
    pair = Pair(small_core)
    pair.read(300, 512)
    pair.send(frame("HELLO", id=1, session=1, version_min=1, version_max=1))
    pair.send(frame("SET_MODE", id=2, mode=1))
    pair.send(frame("CAPTURE", id=3, u_from=300, u_to=1700, pre=53, count=187))  # neither ends at a tick
    for _ in range(40):
        pair.tick()
    for n, index in enumerate(range(0, 187, 32)):
        pair.send(frame("READ_CAPTURE", id=4 + n, index=index))
        for _ in range(SPACING):
            pair.tick()

    pair.drain()
    chip, core = Kinds.of(pair.chip_events), Kinds.of(pair.core_events)
    assert chip == core
    assert core.names().count("CAPTURE_BLOCK") == 6
    assert EventCode.CAPTURE_DONE in [event.int("code") for event in core.events]


def test_the_identity_says_what_the_chip_has() -> None:
    skip_without_avr()
    board = AvrBoard(Bench(), board_id=77)
    for _ in range(5):
        board.tick()
    board.feed(frame("HELLO", id=1, session=1, version_min=1, version_max=1))
    for _ in range(20):
        board.tick()

    events = StreamDecoder().feed(take_output(board))

    (identity,) = [event for event in events if isinstance(event, Message) and event.name == "IDENTITY"]
    fields = ("board_id", "adc_bits", "capture_time", "capture_size", "sample_time")
    assert [identity.int(name) for name in fields] == [77, ADC_BITS, 200, 200, 2000]


def command(script: Script) -> bytes:
    """Return one of the random host's commands, except those whose times are not times of ticks."""
    while True:
        data = script._command()
        name = ROW_OF_TYPE[data[2]].name if len(data) > 2 and data[2] in ROW_OF_TYPE else ""
        if name not in {"RESET", "CAPTURE"} and data.strip(b"\0") == data[1:-1] and b"\0" not in data[1:-1]:
            return data
