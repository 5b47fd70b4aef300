"""A healthy board passes every check, whichever firmware it has; and the coil is off at the end."""

from __future__ import annotations

import pytest

from gateway.emulator.firmware_model.board import Firmware
from gateway.selftest.rigs import RIGS
from gateway.selftest.table import CHECKS
from gateway.selftest.verdict import Result
from tests.harness.gateway.board_host import FIRMWARES, skip_without_compiler
from tests.harness.gateway.selftest_bench import names_of, selftest

NOT_PROVOKED = ["over-current", "watchdog", "sensor-fault", "stack", "input-at-power-on"]


@pytest.mark.parametrize("rig", sorted(RIGS))
def test_a_healthy_board_passes(rig: str) -> None:
    verdicts = selftest(rig)

    assert names_of(verdicts, Result.FAULT, Result.WARNING) == []
    assert names_of(verdicts, Result.SKIPPED) == NOT_PROVOKED
    assert {verdict.check for verdict in verdicts} == {"end", *(check.name for check in CHECKS)}
    assert verdicts[-1].name == "coil-off"


@pytest.mark.slow
@pytest.mark.parametrize("rig", sorted(RIGS))
@pytest.mark.parametrize("seed", range(1, 6))
def test_no_seed_of_the_noise_raises_an_alarm(seed: int, rig: str) -> None:
    assert names_of(selftest(rig, seed=seed), Result.FAULT, Result.WARNING) == []


@pytest.mark.slow
@pytest.mark.parametrize("effect", [{"force-exponent": 3.0}, {"core-saturation": 1.5}, {"coulomb-friction": 6e-3}])
def test_a_heavy_ball_is_lifted_by_the_top_of_the_input(effect: dict[str, float]) -> None:
    assert names_of(selftest(effects=effect), Result.FAULT, Result.WARNING) == []


def test_the_firmware_in_c_passes() -> None:
    skip_without_compiler()

    verdicts = selftest(firmware=FIRMWARES["c"])

    assert names_of(verdicts, Result.FAULT, Result.WARNING) == []


@pytest.mark.parametrize("check", [check.name for check in CHECKS])
def test_a_check_needs_none_before_it(check: str) -> None:
    verdicts = selftest(names=[check], firmware=Firmware)

    assert names_of(verdicts, Result.FAULT, Result.WARNING) == []
    assert {verdict.check for verdict in verdicts} == {check, "end"}
