"""Tests of faults on the AVR alone (test_chip_faults.py has the rest): the coil is off within a stated time."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from dataclasses import replace
from itertools import pairwise

import pytest

from firmware.sim.avr.board import CYCLES_PER_TICK, CYCLES_PER_US, AvrBoard, stored
from gateway.emulator.firmware_model.flash import CE152_BOARD, GAINS, LIMITS
from gateway.emulator.firmware_model.output import OutputFault
from protocol.wire.messages import NOT_KNOWN, EventCode, Flag, Mode
from tests.harness.firmware.avr_bench import AvrHost, skip_without_avr
from tests.harness.gateway.board_host import Bench

BOOT_TICKS = 4  # from a reset to tick 0: 4 to 6 ms
OFF_AFTER_RESET_US = 200  # a bus that is held, freed; then the write of 0
IDENTITY_SIZE = 42  # in the EEPROM, with its CRC


@pytest.fixture(autouse=True)
def _installed() -> None:
    skip_without_avr()


@pytest.fixture
def bench() -> Bench:
    return Bench(i_a=0.6365)


@pytest.fixture
def host(bench: Bench) -> AvrHost:
    """A chip in closed loop with the coil on, its host there for 0.5 s."""
    host = AvrHost(AvrBoard(bench))
    host.run(BOOT_TICKS)
    host.hello()
    assert host.request("SET_MODE", mode=int(Mode.CLOSED_LOOP)).name == "ACK"
    host.run(5)
    assert host.board.u > 1000
    return host


def test_after_a_dip_of_the_supply_the_first_thing_is_a_write_of_0(host: AvrHost) -> None:
    host.board.brown_out()
    code = host.board.u

    ticks = host.ticks_until_off(max_ticks=1)
    reset = host.until(EventCode.RESET_POWER_ON)

    assert code > 1000  # the converter has a supply of its own
    assert ticks == 1
    assert (reset.int("detail"), host.board.mode) == (0, Mode.IDLE)


@pytest.mark.parametrize("stored_code", [2048, 0, 0x2000])  # half of the range, as from the factory; 0; power-down
def test_a_converter_that_wakes_up_with_a_current_is_taught_to_wake_up_with_0(stored_code: int) -> None:
    host = AvrHost(AvrBoard(Bench()))
    host.board.store_input(stored_code)
    host.board.reset(EventCode.RESET_POWER_ON)
    before = host.board.u

    off = host.ticks_until_off(max_ticks=1)
    host.until(EventCode.RESET_POWER_ON)
    host.hello()

    assert before == stored_code & 0xFFF
    assert off == 1
    assert host.board.stored_input == 0
    assert host.request("GET_HEALTH").int("u_power_on") == 0
    assert host.request("SET_MODE", mode=int(Mode.OPEN_LOOP)).name == "ACK"
    assert EventCode.OUTPUT_FAULT not in host.codes()


@pytest.mark.parametrize("fault", [OutputFault.DEAF, OutputFault.STUCK])
def test_a_converter_that_does_not_store_is_not_said_to_wake_up_with_0(host: AvrHost, fault: OutputFault) -> None:
    host.board.store_input(2048)
    host.board.fail_output(fault)
    host.board.reset(EventCode.RESET_POWER_ON)
    host.until(EventCode.RESET_POWER_ON)
    host.hello()

    assert host.request("GET_HEALTH").int("u_power_on") == {OutputFault.DEAF: NOT_KNOWN, OutputFault.STUCK: 2048}[fault]


def test_without_power_the_board_shows_nothing_of_its_memory(host: AvrHost) -> None:
    host.board.reset(EventCode.RESET_POWER_ON)

    memory = (host.board.mode, host.board.dropped, host.board.bad_frames, host.board.next_tick)
    assert memory == (Mode.IDLE, 0, 0, 0)


def test_an_input_converter_that_does_not_answer_stops_nothing_and_is_a_fault(host: AvrHost) -> None:
    code = host.board.u
    host.board.fail_output(OutputFault.DEAF)
    states = len(host.states)
    host.run(100)
    during = host.states[states:]
    stopped = host.request("STOP")
    host.run(3)
    last_state = host.states[-1]
    host.board.fail_output(OutputFault.NONE)
    host.ticks_until_off(max_ticks=2)

    assert len(during) == pytest.approx(100, abs=2)
    assert EventCode.OVERRUN not in host.codes()
    assert stopped.name == "ACK"
    assert (last_state.u_c, last_state.flags & (Flag.FAULT | 3)) == (code, Flag.FAULT)
    assert host.the_event(EventCode.OUTPUT_FAULT).int("detail") == code


def test_after_a_reset_a_converter_that_does_not_answer_is_a_fault_again(host: AvrHost) -> None:
    code = host.board.u
    host.board.fail_output(OutputFault.DEAF)
    host.request("RESET")
    host.until(EventCode.RESET_COMMANDED)
    host.run(10)

    assert host.board.u == code  # nothing can be done about it
    assert host.states[-1].u_c == 4095  # at most
    assert host.states[-1].flags & Flag.FAULT
    assert host.codes()[-1] == EventCode.OUTPUT_FAULT


@pytest.mark.parametrize("held", [1, 9])
@pytest.mark.parametrize("byte", [1, 2, 3])
def test_a_reset_in_an_acknowledge_of_the_converter_switches_off(host: AvrHost, byte: int, held: int) -> None:
    """The converter keeps its output through the reset and holds the bus: only clocks free it."""
    host.board.reset_in_acknowledge(byte, held=held)
    code = host.board.u
    begin = host.board.cycle
    while host.board.u and host.board.cycle < begin + 2 * CYCLES_PER_TICK:
        host.board.run_for(10)
    took_us = (host.board.cycle - begin) / CYCLES_PER_US
    print(f"0 after {took_us:.0f} us")
    host.until(EventCode.RESET_WATCHDOG)
    host.run(10)

    assert code > 1000
    assert host.board.u == 0
    assert took_us < OFF_AFTER_RESET_US
    assert EventCode.OUTPUT_FAULT not in host.codes()


@pytest.mark.parametrize("falls", [1, 9])
def test_a_converter_that_holds_its_bus_is_freed_by_clocks(host: AvrHost, falls: int) -> None:
    """As an edge of SCL too many makes it: the write times out, and the next one is confirmed."""
    host.board.hold_bus(falls)
    host.run(2)
    host.send("STOP")

    host.ticks_until_off(max_ticks=2)

    host.run(10)
    assert not {EventCode.OUTPUT_FAULT, EventCode.OVERRUN} & set(host.codes())


def test_a_bus_that_nothing_frees_stops_nothing_and_is_a_fault(host: AvrHost) -> None:
    host.board.hold_bus(60000)  # a short circuit
    states, start = len(host.states), len(host.cycles)
    host.run(100)
    during, longest = host.states[states:], max(host.cycles[start:])
    stopped = host.request("STOP")
    host.board.hold_bus(0)
    host.ticks_until_off(max_ticks=2)

    assert len(during) == pytest.approx(100, abs=2)
    assert longest < 0.9 * CYCLES_PER_TICK
    assert stopped.name == "ACK"
    assert {EventCode.OUTPUT_FAULT} <= set(host.codes())
    assert EventCode.OVERRUN not in host.codes()


@pytest.mark.parametrize("bit_us", [3, 8])
def test_the_interrupt_of_a_capture_does_not_enter_itself_on_a_slow_bus(host: AvrHost, bit_us: int) -> None:
    """With 8 us a bit the step takes longer than the time to the next sample, which waits."""
    host.board.slow_bus(bit_us)
    for n in range(1, 11):
        host.request("SET_MODE", mode=int(Mode.OPEN_LOOP))
        assert host.request("CAPTURE", u_from=300, u_to=1700, pre=10 + n, count=60).name == "ACK"
        inputs = set()
        while host.codes().count(EventCode.CAPTURE_DONE) < n:
            host.run()
            inputs.add(host.board.u)
        assert {300, 1700} <= inputs

    assert host.board.broken_writes == 0
    assert EventCode.OUTPUT_FAULT not in host.codes()


def test_absurd_settings_with_a_right_crc_give_way_to_those_of_the_program() -> None:
    content = stored(7, replace(CE152_BOARD, limits=replace(LIMITS, u_max=60000)))

    host = started_with(content)

    assert host.request("GET_PARAMETERS").int("u_max") == LIMITS.u_max
    assert host.the_event(EventCode.SETTINGS_REJECTED).int("detail") == 17


def test_a_state_that_the_board_loses_is_missing_and_nothing_else_is(host: AvrHost, bench: Bench) -> None:
    bench.lossy = True
    first = host.board.next_tick
    host.run(5)
    bench.lossy = False
    after = host.board.next_tick
    answer = host.request("PING")
    host.run(20)

    missing = {a + n for a, b in pairwise(s.sequence for s in host.states) for n in range(1, b - a)}
    begin = min(missing)
    assert missing == set(range(begin, begin + after - first))
    assert begin - first in (0, 1)  # a tick may have begun
    assert answer.name == "PONG"
    assert host.bad_frames == 0


def test_settings_of_the_eeprom_are_in_force() -> None:
    parameters = started_with(with_gain(stored(7), 1234)).request("GET_PARAMETERS")

    assert parameters.int("k1_mantissa") == 1234


@pytest.mark.parametrize("damage", ["a bit of the gains", "a bit of the CRC", "blank", "cut short"])
def test_damaged_settings_give_way_to_those_of_the_program(damage: str) -> None:
    content = bytearray(with_gain(stored(7), 1234))
    if damage == "a bit of the gains":
        content[IDENTITY_SIZE + 7] ^= 4
    elif damage == "a bit of the CRC":
        content[-1] ^= 1
    else:
        content[IDENTITY_SIZE if damage == "blank" else IDENTITY_SIZE + 11 :] = b"\xff" * 60

    host = started_with(bytes(content))
    parameters = host.request("GET_PARAMETERS")

    names = [f"k{n}_{part}" for n in range(1, 5) for part in ("mantissa", "shift")]
    values = [value for pair in zip(GAINS.mantissas, GAINS.shifts, strict=True) for value in pair]
    assert [parameters.int(name) for name in names] == values
    limits = (LIMITS.x_ref_min, LIMITS.x_ref_max, LIMITS.x_ref_step, LIMITS.x_ref_slew, LIMITS.u_max)
    assert tuple(parameters.int(name) for name in ("x_ref_min", "x_ref_max", "x_ref_step", "x_ref_slew", "u_max")) == (
        limits
    )
    assert host.hello().int("board_id") == 7  # the identity has a CRC of its own


def test_a_damaged_identity_is_that_of_the_program_with_the_same_scalings() -> None:
    expected = started_with(stored(7)).hello().values
    content = bytearray(stored(7))
    content[2] ^= 1

    identity = started_with(bytes(content)).hello().values

    differing = {name for name in expected if identity[name] != expected[name]} - {"tick"}
    assert differing == {"board_id"}
    assert identity["board_id"] == 0


def with_gain(content: bytes, mantissa: int) -> bytes:
    """The EEPROM with another first gain, and the CRC that belongs to it."""
    settings = bytearray(content[IDENTITY_SIZE:-2])
    struct.pack_into("<h", settings, 5, mantissa)
    return content[:IDENTITY_SIZE] + settings + crc_hqx(bytes(settings), 0xFFFF).to_bytes(2, "little")


def started_with(content: bytes) -> AvrHost:
    """A chip with this in its EEPROM, a session open."""
    board = AvrBoard(Bench())
    board.store(content)
    board.reset(EventCode.RESET_POWER_ON)
    host = AvrHost(board)
    host.run(BOOT_TICKS)
    host.hello()
    return host


def test_a_converter_that_never_ends_a_conversion_is_an_over_current(host: AvrHost) -> None:
    """Interrupts are off while it converts: a wait without an end would be the watchdog's."""
    host.board.fail_conversion()
    dead_from = host.board.next_tick

    fault = host.until(EventCode.OVER_CURRENT)

    assert fault.int("tick") - dead_from <= 51
    assert (host.board.u, host.board.mode) == (0, Mode.IDLE)
    assert not {EventCode.RESET_WATCHDOG, EventCode.OVERRUN} & set(host.codes())
