"""Tests of faults on the 8051 alone (test_chip_faults.py has the rest), and of the time when the coil is off."""

from __future__ import annotations

import pytest

from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.codec import unpack_pair
from protocol.wire.messages import EventCode, Mode
from tests.harness.firmware.chip_host import ChipHost
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench, frame

OVER_CURRENT_TICKS = 50


@pytest.fixture(autouse=True)
def _installed() -> None:
    skip_without_sdcc()


def flying(plant: EmulatedPlant | Bench | None = None, *, eeprom: bytes | None = None) -> ChipHost[Mcs51Board]:
    """A board in closed loop that does not miss its host."""
    host = ChipHost(Mcs51Board(EmulatedPlant(seed=2) if plant is None else plant, eeprom=eeprom))
    host.run(20)
    host.hello()
    host.request("SET_HOST_LOSS", policy=0, timeout=60000)
    host.request("SET_MODE", mode=int(Mode.CLOSED_LOOP))
    host.run(200)
    assert host.board.mode == Mode.CLOSED_LOOP
    return host


def test_with_a_damaged_data_memory_it_flies_with_the_gains_of_its_program() -> None:
    damaged = bytearray(Mcs51Board(Bench()).chip.eeprom)
    damaged[45] ^= 0x80  # a gain
    host = flying(eeprom=bytes(damaged))
    host.run(400)

    assert all(abs(state.x - state.x_ref) < 40 for state in host.states[-100:])


def test_a_converter_that_never_ends_a_conversion_is_an_over_current() -> None:
    host = flying()
    host.board.chip.dead_converter = True

    dead_from = host.board.next_tick
    fault = host.until(EventCode.OVER_CURRENT)

    assert fault.int("tick") - dead_from <= OVER_CURRENT_TICKS + 1
    assert (host.board.u, host.board.mode) == (0, Mode.IDLE)
    assert EventCode.OVERRUN not in host.codes()


def test_stop_acts_before_the_next_tick() -> None:
    """Its 7 bytes are in 609 us after they began; 1 ms later the coil is off."""
    bench = Bench(i_a=0.6365)
    host = flying(bench)
    bench.inputs.clear()
    host.board.feed(frame("STOP", id=99), into_tick_us=87)
    host.run(1)

    on_us = sum(us for u_v, us in bench.inputs if u_v > 0)
    assert on_us < 609 + 1000
    assert host.board.u == 0


def test_a_capture_shows_the_step_at_its_sample() -> None:
    host = flying()
    host.request("SET_MODE", mode=int(Mode.IDLE))
    host.run(200)
    host.request("CAPTURE", u_from=0, u_to=1700, pre=20, count=200)
    host.until(EventCode.CAPTURE_DONE)
    samples: list[int] = []
    for index in range(0, 224, 32):
        packed = host.request("READ_CAPTURE", index=index).bytes("samples")
        samples += [count for k in range(0, 48, 3) for count in unpack_pair(packed[k : k + 3])]

    assert max(samples[:21]) < 20
    assert samples[40] > samples[25] > 20
    assert samples[199] > 300
    assert samples[200:] == [0] * 24


def test_a_reset_by_its_pin_is_no_fault_of_the_firmware() -> None:
    host = flying()
    host.board.pull_reset()
    off = host.board.u
    reset = host.until(EventCode.RESET_POWER_ON)

    assert off == 0
    assert reset.int("detail") == 0
    assert not {EventCode.RESET_WATCHDOG, EventCode.RESET_COMMANDED} & set(host.codes())


def test_a_dip_of_the_supply_switches_off_waits_and_is_no_fault_of_the_firmware() -> None:
    host = flying()
    host.board.chip.low_supply = True
    ticks = host.ticks_until_off(max_ticks=2)
    states = len(host.states)
    host.run(100)
    during = len(host.states) - states
    host.board.chip.low_supply = False
    reset = host.until(EventCode.RESET_POWER_ON)

    assert ticks <= 2
    assert during <= 2  # it waits for its supply
    assert (reset.int("detail"), host.board.u) == (0, 0)
    assert EventCode.RESET_WATCHDOG not in host.codes()


def test_the_watchdog_and_a_command_are_told_from_power_and_from_each_other() -> None:
    host = flying()
    host.board.hang()
    watchdog = host.until(EventCode.RESET_WATCHDOG)
    host.run(20)
    host.hello()
    host.request("RESET")
    commanded = host.until(EventCode.RESET_COMMANDED)
    xram = host.board.chip.cpu.xram
    xram[0x7FA] ^= 0x40  # of the count, which its complement then does not fit
    host.board.hang()
    damaged = host.until(EventCode.RESET_WATCHDOG)

    assert [event.int("detail") for event in (watchdog, commanded, damaged)] == [1, 2, 1]
