"""Tests of faults on either chip: in each case the input of the coil is 0 within a stated number of ticks."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import pytest

from firmware.sim.avr.board import AvrBoard
from firmware.sim.mcs51.board import Mcs51Board
from protocol.wire.messages import EventCode, Mode
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.chip_host import ChipHost
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench, frame

BOOT_TICKS = 10  # from power on to tick 0, and a few
HOST_LOST_TICKS = 252  # 500 ms
OVER_CURRENT_TICKS = 52
SENSOR_FAULT_TICKS = 502


@dataclass
class Chip:
    """A chip in closed loop with the coil on, its host there for 0.5 s."""

    make: Callable[[Bench], Any]
    skip: Callable[[], None]
    watchdog_ticks: int  # its time, and the start-up to the first write of u_c

    def fly(self) -> None:
        self.skip()
        self.bench = Bench(i_a=0.6365)
        self.host: ChipHost[Any] = ChipHost(self.make(self.bench))
        self.host.run(BOOT_TICKS)
        self.host.hello()
        assert self.host.request("SET_MODE", mode=int(Mode.CLOSED_LOOP)).name == "ACK"
        self.host.run(5)
        assert self.host.board.u > 1000


@pytest.fixture(params=[(AvrBoard, skip_without_avr, 18), (Mcs51Board, skip_without_sdcc, 17)], ids=["AVR", "8051"])
def chip(request: pytest.FixtureRequest) -> Chip:
    flying = Chip(*request.param)
    flying.fly()
    return flying


@pytest.fixture
def host(chip: Chip) -> ChipHost[Any]:
    return chip.host


def test_a_program_that_hangs_is_reset_by_the_watchdog(chip: Chip, host: ChipHost[Any]) -> None:
    host.board.hang()

    ticks = host.ticks_until_off(max_ticks=chip.watchdog_ticks)
    reset = host.until(EventCode.RESET_WATCHDOG)

    assert ticks > 10  # until then the input is what it was: the program cannot know
    assert reset.int("detail") == 1
    assert host.board.mode == Mode.IDLE


def test_a_watchdog_reset_within_a_command_loses_that_command_alone(host: ChipHost[Any]) -> None:
    command = frame("SET_MODE", id=9, mode=1)
    host.board.feed(command[:5])
    host.run()
    host.board.hang()
    host.until(EventCode.RESET_WATCHDOG)
    host.board.feed(command[5:])
    host.run(3)
    identity = host.hello()

    assert (identity.name, identity.int("reset_cause")) == ("IDENTITY", EventCode.RESET_WATCHDOG)
    assert (host.board.u, host.board.mode) == (0, Mode.IDLE)
    assert host.request("PING").int("bad_frames") == 1
    assert host.request("SET_MODE", mode=1).name == "ACK"


def test_a_commanded_reset_sends_its_ack_and_switches_off_first(host: ChipHost[Any]) -> None:
    answer = host.request("RESET")
    host.ticks_until_off(max_ticks=3)
    reset = host.until(EventCode.RESET_COMMANDED)

    assert answer.name == "ACK"
    assert reset.int("detail") == 1


def test_resets_are_counted_from_power_on(host: ChipHost[Any]) -> None:
    host.board.hang()
    host.until(EventCode.RESET_WATCHDOG)
    host.board.hang()
    second = host.until(EventCode.RESET_WATCHDOG)
    host.board.reset(EventCode.RESET_POWER_ON)
    power_on = host.until(EventCode.RESET_POWER_ON)

    assert second.int("detail") == 2
    assert power_on.int("detail") == 0


def test_power_is_interrupted(host: ChipHost[Any]) -> None:
    host.board.reset(EventCode.RESET_POWER_ON)

    assert host.ticks_until_off(max_ticks=1) == 1
    host.until(EventCode.RESET_POWER_ON)
    assert host.hello().name == "IDENTITY"
    assert host.board.u == 0


def test_a_host_that_is_gone_switches_off(host: ChipHost[Any]) -> None:
    host.request("PING")

    ticks = host.ticks_until_off(max_ticks=HOST_LOST_TICKS)

    assert ticks > 240
    host.run(20)
    host.the_event(EventCode.HOST_LOST)


def test_a_current_converter_that_is_stuck_at_its_end_switches_off(chip: Chip, host: ChipHost[Any]) -> None:
    host.request("SET_HOST_LOSS", policy=0, timeout=60000)
    chip.bench.i_a = 5.0
    chip.bench.x_m = 2.6e-3  # so that the law keeps the coil on

    host.ticks_until_off(max_ticks=OVER_CURRENT_TICKS)

    host.run(20)
    assert host.the_event(EventCode.OVER_CURRENT).int("detail") == 4095  # 1023 of 10 bits is the end of 12


def test_a_position_converter_that_is_stuck_at_its_end_switches_off(chip: Chip, host: ChipHost[Any]) -> None:
    host.request("SET_HOST_LOSS", policy=0, timeout=60000)
    chip.bench.x_m = -1.0
    host.run(20)
    assert host.board.u > 0  # the law lifts a ball that seems to lie at the bottom

    host.ticks_until_off(max_ticks=SENSOR_FAULT_TICKS)

    host.run(20)
    assert host.the_event(EventCode.SENSOR_FAULT).int("detail") == 0


def test_a_stack_that_is_too_deep_switches_off_until_a_reset(host: ChipHost[Any]) -> None:
    free = host.request("GET_HEALTH").int("stack_free")
    host.board.break_stack()

    assert host.ticks_until_off(max_ticks=2) > 0
    host.run(20)
    host.the_event(EventCode.STACK_FAULT)
    assert host.request("GET_HEALTH").int("stack_free") == 0
    assert host.request("SET_MODE", mode=int(Mode.CLOSED_LOOP)).name == "ACK"
    host.run(5)
    assert (host.board.u, host.board.mode) == (0, Mode.IDLE)
    host.run(20)
    assert host.codes().count(EventCode.STACK_FAULT) == 2
    host.request("RESET")
    host.until(EventCode.RESET_COMMANDED)
    host.hello()
    assert 20 < free <= host.request("GET_HEALTH").int("stack_free") < 200  # painted anew
    assert host.request("SET_MODE", mode=int(Mode.CLOSED_LOOP)).name == "ACK"
    host.run(5)
    assert host.board.u > 0


def test_a_late_tick_is_reported(host: ChipHost[Any]) -> None:
    host.board.overrun()

    host.until(EventCode.OVERRUN)


@pytest.mark.parametrize("flood", ["noise", "zeros", "commands"])
def test_a_line_that_is_full_of_anything_delays_no_tick_and_no_stop(host: ChipHost[Any], flood: str) -> None:
    """As fast as the line is: 23 bytes in a tick."""
    chance, first = random.Random(5), host.board.next_tick
    for n in range(1000):
        if flood == "noise":
            data = chance.randbytes(23)
        elif flood == "zeros":
            data = bytes(23)
        else:
            data = 2 * frame("GET_PARAMETERS", id=n % 250 + 1) + frame("PING", id=n % 249 + 1)[:7]
        host.board.feed(data)
        host.run()
    ticks = host.board.next_tick - first
    host.board.feed(bytes(2))
    host.board.feed(frame("STOP", id=255))

    host.ticks_until_off(max_ticks=3)

    assert abs(ticks - 1000) <= 1  # one may have begun
    assert EventCode.OVERRUN not in host.codes()
    assert host.bad_frames == 0
    assert not isinstance(host.board, Mcs51Board) or host.board.chip.lost_bytes == 0
    sequences = [state.sequence for state in host.states[-500:]]
    assert all(b - a == 1 for a, b in pairwise(sequences))
