"""What goes wrong on the 8051's chip, and how many ticks later the coil is without current."""

from __future__ import annotations

import pytest

from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.codec import unpack_pair
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import EventCode, Message, Mode
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench, frame
from tests.harness.protocol.port import take_output

WATCHDOG_TICKS = 16  # 31.25 ms
BOOT_TICKS = 5
LINE_TICKS = 20  # until an EVENT has had its turn on the line
OVER_CURRENT_TICKS = 50
SENSOR_FAULT_TICKS = 500


@pytest.fixture(autouse=True)
def _installed() -> None:
    skip_without_sdcc()


class Flight:
    """A board in closed loop that hears a host as long as `alive`."""

    def __init__(self, plant: EmulatedPlant | Bench | None = None, *, eeprom: bytes | None = None) -> None:
        self.board = Mcs51Board(EmulatedPlant(seed=2) if plant is None else plant, eeprom=eeprom)
        self.decoder = StreamDecoder()
        self.states: list[State] = []
        self.messages: list[Message] = []
        self.ticks = 0
        self.run(20)
        self.board.feed(frame("HELLO", id=1, session=1, version_min=1, version_max=1))
        self.run(10)
        self.board.feed(frame("SET_MODE", id=2, mode=2))
        self.run(200)
        assert self.board.mode == Mode.CLOSED_LOOP

    def run(self, ticks: int, *, alive: bool = True) -> None:
        for _ in range(ticks):
            self.ticks += 1
            if alive and self.ticks % 100 == 0:
                self.board.feed(frame("PING", id=self.ticks // 100 % 100 + 150))
            self.board.tick()
            for event in self.decoder.feed(take_output(self.board)):
                if isinstance(event, State):
                    self.states.append(event)
                elif isinstance(event, Message):
                    self.messages.append(event)

    def ticks_until_off(self, most: int, *, alive: bool = True) -> int:
        before = self.board.next_tick
        for n in range(1, most + 1):
            self.run(1, alive=alive)
            if self.board.u == 0 and (self.board.mode == Mode.IDLE or self.board.next_tick < before):
                return n
        raise AssertionError(f"u_c is {self.board.u} in {self.board.mode!r} after {most} ticks")

    def codes(self) -> list[EventCode]:
        return [EventCode(m.int("code")) for m in self.messages if m.name == "EVENT"]


def test_a_program_that_hangs_is_reset_and_says_so() -> None:
    flight = Flight()
    flight.board.hang()

    assert flight.ticks_until_off(WATCHDOG_TICKS + 1) <= WATCHDOG_TICKS
    flight.run(20)
    assert flight.codes()[-1] == EventCode.RESET_WATCHDOG
    assert flight.messages[-1].int("detail") == 1
    assert flight.board.mode == Mode.IDLE


def test_a_reset_in_the_middle_of_a_command_loses_that_command_alone() -> None:
    flight = Flight()
    command = frame("SET_MODE", id=9, mode=1)
    flight.board.feed(command[:4])
    flight.run(1)
    flight.board.hang()
    flight.run(WATCHDOG_TICKS + BOOT_TICKS)
    flight.board.feed(command[4:] + frame("HELLO", id=10, session=2, version_min=1, version_max=1))
    flight.run(10)

    assert (flight.board.u, flight.board.mode, flight.board.bad_frames) == (0, Mode.IDLE, 1)
    assert flight.messages[-1].name == "IDENTITY"
    assert flight.messages[-1].int("reset_cause") == EventCode.RESET_WATCHDOG


def test_without_power_for_a_moment_it_begins_with_the_coil_off() -> None:
    flight = Flight()
    flight.board.reset(EventCode.RESET_POWER_ON)

    assert flight.board.u == 0
    flight.run(20)
    assert flight.board.u == 0
    assert (flight.codes()[-1], flight.messages[-1].int("detail")) == (EventCode.RESET_POWER_ON, 0)


def test_a_commanded_reset_sends_its_ack_and_is_told_from_the_others() -> None:
    flight = Flight()
    flight.board.feed(frame("RESET", id=77))

    assert flight.ticks_until_off(WATCHDOG_TICKS) <= 4
    flight.run(20)
    names = [m.name for m in flight.messages[-2:]]
    assert names == ["ACK", "EVENT"]
    assert flight.codes()[-1] == EventCode.RESET_COMMANDED


def test_with_a_damaged_data_memory_it_flies_with_the_gains_of_its_program() -> None:
    damaged = bytearray(Mcs51Board(Bench()).chip.eeprom)
    damaged[45] ^= 0x80  # a gain
    flight = Flight(eeprom=bytes(damaged))
    flight.run(400)

    assert all(abs(state.x - state.x_ref) < 40 for state in flight.states[-100:])


def test_without_a_host_the_coil_is_off_after_the_time_out() -> None:
    flight = Flight()
    flight.board.feed(frame("SET_HOST_LOSS", id=5, policy=1, timeout=100))
    flight.run(3, alive=False)

    assert flight.ticks_until_off(60, alive=False) in range(46, 53)
    flight.run(LINE_TICKS, alive=False)
    assert EventCode.HOST_LOST in flight.codes()


def test_a_converter_that_never_ends_a_conversion_is_an_over_current() -> None:
    flight = Flight()
    flight.board.chip.dead_converter = True

    assert flight.ticks_until_off(OVER_CURRENT_TICKS + 2) <= OVER_CURRENT_TICKS + 1
    flight.run(LINE_TICKS)
    assert EventCode.OVER_CURRENT in flight.codes()
    assert EventCode.OVERRUN not in flight.codes()


@pytest.mark.parametrize(
    ("stuck", "within", "code"),
    [("i_a", OVER_CURRENT_TICKS, EventCode.OVER_CURRENT), ("x_m", SENSOR_FAULT_TICKS, EventCode.SENSOR_FAULT)],
)
def test_a_converter_stuck_at_its_end_switches_off(stuck: str, within: int, code: EventCode) -> None:
    bench = Bench(i_a=0.6365)
    flight = Flight(bench)
    bench.i_a = 0.1  # the law switches the coil off where the ball seems to be at its top
    setattr(bench, stuck, 5.0)

    assert flight.ticks_until_off(within + 5) <= within + 2
    flight.run(LINE_TICKS)
    assert code in flight.codes()


def test_stop_acts_before_the_next_tick() -> None:
    """Its 7 bytes are in 609 us after they began; 1 ms later the coil is off."""
    bench = Bench(i_a=0.6365)
    flight = Flight(bench)
    bench.inputs.clear()
    flight.board.feed(frame("STOP", id=99), into_tick_us=87)
    flight.run(1)

    on_us = sum(us for u_v, us in bench.inputs if u_v > 0)
    assert on_us < 609 + 1000
    assert flight.board.u == 0


def test_a_flood_of_noise_costs_no_tick() -> None:
    flight = Flight()
    before = flight.board.next_tick
    for n in range(200):
        noise = bytes((n * 7 + k * 31) % 255 + 1 for k in range(10)) + b"\0" + encode_frame(bytes((0x33, n + 1)))[:8]
        flight.board.feed(noise)
        flight.run(1, alive=False)

    assert flight.board.next_tick - before == 200
    assert flight.board.chip.lost_bytes == 0
    assert flight.board.bad_frames > 150
    assert EventCode.OVERRUN not in flight.codes()
    assert abs(flight.states[-1].x - flight.states[-1].x_ref) < 60


def test_a_late_tick_is_told() -> None:
    flight = Flight()
    flight.board.overrun()
    flight.run(LINE_TICKS)

    assert EventCode.OVERRUN in flight.codes()


def test_a_capture_shows_the_step_at_its_sample() -> None:
    flight = Flight()
    flight.board.feed(frame("SET_MODE", id=3, mode=0))
    flight.run(200)
    flight.board.feed(frame("CAPTURE", id=4, u_from=0, u_to=1700, pre=20, count=200))
    flight.run(40)
    assert flight.codes()[-1] == EventCode.CAPTURE_DONE
    samples: list[int] = []
    for n in range(7):
        flight.board.feed(frame("READ_CAPTURE", id=20 + n, index=32 * n))
        flight.run(12)
        packed = next(m for m in flight.messages[::-1] if m.name == "CAPTURE_BLOCK").values["samples"]
        assert isinstance(packed, bytes)
        samples += [count for k in range(0, 48, 3) for count in unpack_pair(packed[k : k + 3])]

    assert max(samples[:21]) < 20
    assert samples[40] > samples[25] > 20
    assert samples[199] > 300
    assert samples[200:] == [0] * 24
