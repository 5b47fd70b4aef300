"""The calibration of x on the chips: in force, kept in the EEPROM of the AVR, and gone where that is damaged."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from typing import Any

import pytest

from firmware.sim.avr.board import CYCLES_PER_TICK, AvrBoard, stored
from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.firmware_model.calibration import Calibration
from gateway.emulator.firmware_model.flash import POSITION
from protocol.wire.messages import EventCode, Mode, Reason
from tests.harness.firmware.avr_bench import AvrHost, skip_without_avr
from tests.harness.firmware.chip_host import ChipHost
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench

POINTS = {"low_read": 112, "low_true": 164, "high_read": 3251, "high_true": 3441}
NONE = {"low_read": 0, "low_true": 0, "high_read": 4095, "high_true": 4095}
BOOT_TICKS = 10
WRITTEN_TICKS = 25  # 10 bytes of 3.4 ms
AT = 73  # in the EEPROM: firmware/avr/store.c


def begun(board: AvrBoard | Mcs51Board) -> Any:
    host: Any = AvrHost(board) if isinstance(board, AvrBoard) else ChipHost(board)
    host.run(40)
    host.hello()
    return host


def in_force(host: Any) -> dict[str, int]:
    answer = host.request("GET_CALIBRATION")
    return {name: answer.int(name) for name in (*NONE, "kept")}


@pytest.fixture
def avr() -> AvrHost:
    skip_without_avr()
    host: AvrHost = begun(AvrBoard(Bench()))
    return host


def after_power_on(host: AvrHost) -> dict[str, int]:
    host.board.reset(EventCode.RESET_POWER_ON)
    host.run(BOOT_TICKS)
    host.hello()
    return in_force(host)


def test_it_is_in_the_eeprom_after_some_ticks_and_outlives_the_power(avr: AvrHost) -> None:
    before = len(avr.cycles)
    assert avr.request("SET_CALIBRATION", **POINTS).name == "ACK"
    at_once = in_force(avr)
    avr.run(WRITTEN_TICKS)
    later = in_force(avr)
    longest = max(avr.cycles[before:])

    assert at_once == POINTS | {"kept": 0}
    assert later == POINTS | {"kept": 1}
    assert after_power_on(avr) == POINTS | {"kept": 1}
    assert longest < 0.9 * CYCLES_PER_TICK
    assert EventCode.OVERRUN not in avr.codes()


def test_power_that_goes_while_it_is_written_leaves_none(avr: AvrHost) -> None:
    for ticks in (0, 3, 6):  # the simulator takes a byte in each tick, a chip in each second one
        avr.request("SET_CALIBRATION", **POINTS | {"low_true": 164 + ticks})
        avr.run(ticks)

        assert after_power_on(avr) == NONE | {"kept": 0}


@pytest.mark.parametrize("content", [b"\xff" * 10, struct.pack("<5H", *POINTS.values(), 0)], ids=["blank", "CRC"])
def test_a_damaged_one_is_none(avr: AvrHost, content: bytes) -> None:
    avr.board.store(stored(7) + content)

    assert after_power_on(avr) == NONE | {"kept": 0}


@pytest.mark.parametrize("counts", [(0, 501, 4095, 4095), (63488, 63488, 0, 0), (0, 0, 4096, 4096)])
def test_one_that_would_be_refused_is_none_whatever_its_crc_says(avr: AvrHost, counts: tuple[int, ...]) -> None:
    points = struct.pack("<4H", *counts)
    avr.board.store(stored(7) + points + crc_hqx(points, 0xFFFF).to_bytes(2, "little"))

    assert len(stored(7)) == AT
    assert after_power_on(avr) == NONE | {"kept": 1}


@pytest.mark.parametrize("chip", [AvrBoard, Mcs51Board])
def test_a_chip_corrects_as_the_model_does(chip: type) -> None:
    skip_without_avr() if chip is AvrBoard else skip_without_sdcc()
    bench = Bench()
    host = begun(chip(bench))
    host.run(2)
    readings = list(range(3, 4095, 151))
    uncorrected: list[int] = []
    corrected: list[int] = []
    for points, measured in ((NONE, uncorrected), (POINTS, corrected)):
        assert host.request("SET_CALIBRATION", **points).name == "ACK"
        for count in readings:
            bench.x_m = POSITION.to_si(count)
            host.run(4)
            measured.append(host.states[-1].x)

    assert corrected == [Calibration(**POINTS).corrected(x) for x in uncorrected]
    assert max(abs(a - b) for a, b in zip(uncorrected, readings, strict=True)) <= 4  # a step of 10 bits
    assert in_force(host)["kept"] == (chip is AvrBoard)
    refused = host.request("SET_CALIBRATION", **POINTS | {"high_true": 3800})
    assert (refused.int("reason"), refused.int("detail")) == (Reason.OUT_OF_RANGE, 500)
    host.request("SET_MODE", mode=int(Mode.CLOSED_LOOP))
    assert host.request("SET_CALIBRATION", **NONE).int("reason") == Reason.WRONG_MODE
