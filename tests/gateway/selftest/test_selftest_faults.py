"""Tests of one fault at a time: each is found, and the answer names it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from gateway.emulator.faults import parse
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.commands import Nack
from gateway.emulator.firmware_model.flash import CE152_BOARD, ConverterScale
from gateway.emulator.line import BoardLine
from gateway.selftest.report import cause_of
from gateway.selftest.verdict import Result
from protocol.wire.messages import Message, Mode, Reason
from tests.harness.gateway.selftest_bench import names_of, selftest


class NeverLosesItsHost(Firmware):
    def tick(self) -> None:
        self._host.heard()
        super().tick()


class OtherVersion(Firmware):
    def _hello(self, message: Message) -> Nack:
        return Nack(Reason.VERSION, 2)


class FirmwareWithoutCounter(Firmware):
    def _leave_unanswered(self) -> None:
        pass


def wrong_scaling(plant: Any, *, board_id: int, profile: object) -> Firmware:
    scaling = ConverterScale(offset=0.0, lsb=1.0)
    return Firmware(plant, board_id=board_id, profile=replace(CE152_BOARD, position=scaling))


def lost_gains(plant: Any, *, board_id: int, profile: object) -> Firmware:
    gains = replace(CE152_BOARD.gains, mantissas=(0, 0, 0, 0))
    return Firmware(plant, board_id=board_id, profile=replace(CE152_BOARD, gains=gains))


def bad_settings(line: BoardLine) -> None:
    settings = CE152_BOARD.settings
    assert isinstance(line.firmware, Firmware)
    line.firmware.store(replace(settings, limits=replace(settings.limits, u_max=5000)))


def at_current(fault: str) -> Callable[[BoardLine], None]:
    """Begin a fault when the coil is on for 20 ms in open loop."""
    on = [0]

    def watch(line: BoardLine) -> None:
        assert isinstance(line.firmware, Firmware)
        on[0] = on[0] + 1 if line.firmware.u and line.firmware.mode == Mode.OPEN_LOOP else 0
        if on[0] == 10:
            line.inject(parse(fault))
            on[0] = -(10**9)

    return watch


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "lost states": ({"effects": {"lost-samples": 0.01}}, "lost-states"),
    "wrong crystal": ({"faults": ["crystal=1.02"]}, "crystal"),
    "impossible scaling": ({"firmware": wrong_scaling}, "scalings"),
    "settings out of range": ({"prepare": bad_settings}, "settings-rejected"),
    "position unplugged": ({"faults": ["x-unplugged"]}, "position-end"),
    "position inverted": ({"faults": ["x-inverted"]}, "position-polarity"),
    "position frozen": ({"faults": ["x-frozen"]}, "position-frozen"),
    "stuck bit of x": ({"faults": ["x-bit=4"]}, "stuck-bit-x"),
    "current unplugged": ({"faults": ["i-unplugged"]}, "current-sensor"),
    "no coil": ({"faults": ["coil-open"]}, "no-current"),
    "deaf input converter": ({"faults": ["deaf=1000@1"]}, "reported-output-fault"),
    "host loss ignored": ({"firmware": NeverLosesItsHost}, "host-loss"),
}
MORE_FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "damaged bytes": ({"faults": ["flip=1e-3"]}, "ping-loss"),
    "slow answers": ({"faults": ["stall=0.06@0/0.064:rx"]}, "round-trip"),
    "reset loop": ({"faults": ["reset@2/1.5"]}, "unexpected-reset"),
    "position noisy": ({"faults": ["x-noise=60"]}, "position-noise"),
    "stuck bit of i_c": ({"faults": ["i-bit=5"]}, "stuck-bit-i-c"),
    "current slope": ({"effects": {"current-sensor-gain": 0.85}}, "input-gain"),
    "coil reversed": ({"rig": "magnetoshield", "faults": ["coil-reversed"]}, "no-lift"),
    "dead zone": ({"effects": {"amplifier-dead-zone": 0.4}}, "dead-zone"),
    "saturation": ({"effects": {"current-limit": 1.02}}, "saturation"),
    "nothing from the board": ({"faults": ["lost=1:tx"]}, "silence"),
    "no wire to the board": ({"faults": ["lost=1:rx"]}, "deaf-board"),
    "wrong baud rate": ({"faults": ["baud=1000"]}, "garbage"),
    "watchdog": ({"faults": ["watchdog@3/4"]}, "unexpected-reset"),
    "pulled plug": ({"faults": ["disconnect=1000@5"]}, "no-answer"),
    "other version": ({"firmware": OtherVersion}, "protocol-version"),
    "board of another rig": ({"numbers": "magnetoshield"}, "scalings"),
    "gains of 0": ({"firmware": lost_gains}, "settings"),
    "position off": ({"effects": {"position-sensor-offset": 6e-4}}, "position-at-rest"),
    "position slope": ({"effects": {"position-sensor-gain": 0.85}}, "travel"),
    "stuck high bit of i_c": ({"faults": ["i-bit=8"]}, "stuck-bit-i-c"),
    "current noisy": ({"faults": ["i-noise=120"]}, "current-noise"),
    "current off": ({"effects": {"current-sensor-offset": 0.08}}, "current-at-zero"),
    "magnet upside down": ({"rig": "magnetoshield", "faults": ["x-inverted"]}, "position-polarity"),
    "no coil on a shield": ({"rig": "magnetoshield", "faults": ["coil-open"]}, "no-current"),
    "ball sticks": ({"effects": {"constant-force": -0.05, "air-gap-offset": 2e-3}}, "no-lift"),
    "slew rate": ({"effects": {"slew-rate-limit": 100.0}}, "time-constant"),
    "a tick late": ({"effects": {"actuation-delay": 0.002}}, "delay"),
    "late ticks": ({"faults": ["overrun@1/0.01"]}, "overruns"),
    "a stack that is too deep": ({"faults": ["stack@1"]}, "reported-stack-fault"),
    "frames not counted": ({"firmware": FirmwareWithoutCounter}, "unaccounted"),
}


@pytest.mark.parametrize("case", [*FAULTS, *(pytest.param(case, marks=pytest.mark.slow) for case in MORE_FAULTS)])
def test_a_fault_is_found_and_named(case: str) -> None:
    options, name = (FAULTS | MORE_FAULTS)[case]

    verdicts = selftest(**options)

    faults = [verdict for verdict in verdicts if verdict.result == Result.FAULT]
    assert name in names_of(faults, Result.FAULT)
    assert cause_of(faults).name == name
    assert all(verdict.remedy for verdict in verdicts if verdict.result != Result.OK)


@pytest.mark.parametrize("check", ["safety", "load"])
def test_a_shorted_driver_is_a_coil_that_may_be_on(check: str) -> None:
    verdicts = selftest(names=[check], each_tick=at_current("stuck=1000"))

    faults = [verdict for verdict in verdicts if verdict.result == Result.FAULT]
    assert verdicts[-1].name == "coil-off"
    assert verdicts[-1].result == Result.FAULT
    assert "CUT THE SUPPLY" in verdicts[-1].remedy
    assert faults[0].name in ("stop", "stop-in-load", "reported-uncommanded-current")


def test_a_silence_between_two_checks_is_found_by_the_stop_after_one() -> None:
    verdicts = selftest(faults=["stall=3.9@1.7"])

    assert names_of(verdicts, Result.FAULT)[0] in ("jitter", "stop-unanswered")


@pytest.mark.parametrize("check", ["identity", "staircase", "load"])
def test_a_board_that_does_not_answer_is_a_fault_of_any_check(check: str) -> None:
    verdicts = selftest(names=[check], faults=["lost=1:rx"])

    assert names_of(verdicts, Result.FAULT) == ["deaf-board"]
    assert names_of(verdicts, Result.OK) == []


@pytest.mark.parametrize(("faults", "name"), [(["stall=0.8@4.6"], "host-lost"), (["i-bit=4@5"], "stuck-bit-i-c")])
def test_what_comes_and_goes_is_found(faults: list[str], name: str) -> None:
    assert name in names_of(selftest(faults=faults), Result.FAULT, Result.WARNING)


@pytest.mark.slow
def test_a_line_of_small_losses_is_a_warning() -> None:
    verdicts = selftest(names=["link"], faults=["flip=2e-5"], quick=False)

    assert set(names_of(verdicts, Result.WARNING)) <= {"ping-loss", "lost-states", "bad-frames", "bad-to-board"}
    assert names_of(verdicts, Result.WARNING)
    assert names_of(verdicts, Result.FAULT) == []


def test_the_clock_is_measured_with_its_interval() -> None:
    (crystal,) = [
        verdict for verdict in selftest(names=["link"], faults=["crystal=1.001"]) if verdict.name == "crystal"
    ]

    ppm, interval = (float(word) for word in crystal.value.replace("ppm", "").split("±"))
    assert crystal.result == Result.OK
    assert math.isclose(ppm, 1000.0, abs_tol=max(2 * interval, 50.0))


def test_a_sensor_that_reads_differently_is_told_how_to_be_calibrated() -> None:
    effects = {"position-sensor-gain": 0.96, "position-sensor-offset": 1.5e-4}

    verdicts = selftest("magnetoshield", names=["calibration"], effects=effects)

    (line,) = [verdict for verdict in verdicts if verdict.name == "calibration"]
    assert line.result == Result.WARNING
    assert "--only calibration --calibrate" in line.remedy
