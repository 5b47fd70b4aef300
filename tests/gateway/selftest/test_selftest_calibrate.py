"""`board51 selftest --calibrate`: a position sensor that differs reads right afterwards, and the board keeps it so."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest

from firmware.sim import CHIPS
from gateway.emulator.firmware_model.board import Firmware
from gateway.selftest.bench import Bench
from gateway.selftest.checks.calibration import corrected_points
from gateway.selftest.runner import run_checks, switch_off
from gateway.selftest.table import CHECKS
from gateway.selftest.verdict import Result, Verdict
from protocol.wire.messages import Message
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import FIRMWARES, skip_without_compiler
from tests.harness.gateway.selftest_bench import names_of, selftest, virtual_bench

DIFFERS = {"position-sensor-gain": 0.96, "position-sensor-offset": 1.5e-4}
TOO_FAR = {"position-sensor-offset": 9e-4}


def calibrated(rig: str, effects: dict[str, float] = DIFFERS, **options: Any) -> tuple[Bench, list[Verdict]]:
    bench = virtual_bench(rig, effects=effects, **options)
    bench.calibrate = True
    return bench, again(bench)


def again(bench: Bench) -> list[Verdict]:
    verdicts = list(run_checks(bench, [check for check in CHECKS if check.name == "calibration"]))
    return [*verdicts, switch_off(bench)]


@pytest.mark.parametrize("rig", ["ce152", "magnetoshield"])
@pytest.mark.parametrize("firmware", FIRMWARES.values(), ids=FIRMWARES.keys())
def test_the_stops_read_0_and_the_travel_afterwards_also_after_a_reset(rig: str, firmware: Any) -> None:
    skip_without_compiler()
    before = selftest(rig, names=["calibration"], effects=DIFFERS, firmware=firmware)

    bench, verdicts = calibrated(rig, firmware=firmware)
    bench.calibrate = False
    bench.forget_rest()
    later = again(bench)  # it begins with a RESET

    assert "calibration" in names_of(before, Result.WARNING)
    assert names_of(verdicts, Result.OK) == ["travel", "calibration", "calibration-kept", "coil-off"]
    assert names_of(later, Result.OK) == ["travel", "calibration", "coil-off"]


@pytest.mark.slow
@pytest.mark.parametrize(("chip", "rig"), [("avr", "magnetoshield"), ("8051", "ce152")])
def test_an_image_is_calibrated(chip: str, rig: str) -> None:
    skip_without_avr() if chip == "avr" else skip_without_sdcc()

    bench, verdicts = calibrated(rig, firmware=partial(CHIPS[chip], baud=115200))
    bench.calibrate = False
    bench.forget_rest()
    later = again(bench)

    is_stored = chip == "avr"
    assert names_of(verdicts, Result.WARNING) == ([] if is_stored else ["calibration-kept"])
    assert names_of(verdicts, Result.FAULT) == []
    assert ("calibration" in names_of(later, Result.OK)) == is_stored


def test_a_sensor_that_is_right_is_left_alone() -> None:
    bench, verdicts = calibrated("magnetoshield", {})

    assert names_of(verdicts, Result.OK) == ["travel", "calibration", "coil-off"]
    assert bench.line.order("GET_CALIBRATION").int("kept") == 0


def test_a_sensor_that_is_too_far_off_is_a_fault_and_nothing_is_changed() -> None:
    bench, verdicts = calibrated("magnetoshield", TOO_FAR)

    assert names_of(verdicts, Result.FAULT) == ["calibration-refused"]
    assert bench.line.order("GET_CALIBRATION").int("low_true") == 0


def test_firmware_that_takes_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.emulator.firmware_model.flash.FIRMWARE", (1, 3))

    _, verdicts = calibrated("ce152", firmware=Firmware)
    plain = selftest(names=["calibration"], effects=DIFFERS, firmware=Firmware)

    assert "older than 1.4" in verdicts[0].remedy
    assert "flash firmware 1.4" in next(v.remedy for v in plain if v.name == "calibration")


def test_a_second_calibration_counts_from_the_reading_without_any() -> None:
    first = {"low_read": 100, "low_true": 160, "high_read": 3300, "high_true": 3440}
    in_force = Message("CALIBRATION", {"id": 1, **first, "kept": 1})

    assert corrected_points(in_force, 160.0, 3440.0, (160.0, 3440.0)) == first
    assert corrected_points(in_force, 170.5, 3470.75, (160.0, 3440.0)) == first | {"low_read": 110, "high_read": 3330}
    assert corrected_points(in_force, 0.0, 4095.0, (0.0, 4095.0)) == {
        "low_read": 0,
        "low_true": 0,
        "high_read": 3939,
        "high_true": 4095,
    }
