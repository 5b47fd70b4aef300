"""The images of both chips, instruction by instruction, pass the whole self-test."""

from __future__ import annotations

from functools import partial

import pytest

from firmware.sim import CHIPS
from gateway.selftest.verdict import Result
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.selftest_bench import names_of, selftest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("chip", "rig"), [("avr", "ce152"), ("avr", "magnetoshield"), ("8051", "ce152")])
def test_an_image_passes(chip: str, rig: str) -> None:
    skip_without_avr() if chip == "avr" else skip_without_sdcc()

    verdicts = selftest(rig, quick=False, firmware=partial(CHIPS[chip], baud=115200))

    assert names_of(verdicts, Result.FAULT, Result.WARNING) == []


def test_an_image_says_how_much_stack_is_left_and_what_its_converter_wakes_up_with() -> None:
    skip_without_avr()

    verdicts = selftest(firmware=partial(CHIPS["avr"], baud=115200), names=["health"])

    assert [(v.name, v.result) for v in verdicts[:2]] == [("stack", Result.OK), ("input-at-power-on", Result.OK)]


@pytest.mark.parametrize(
    ("fault", "name"),
    [("x-inverted", "position-polarity"), ("coil-open", "no-current"), ("deaf=1000@1", "reported-output-fault")],
)
def test_a_fault_behind_an_image_is_found(fault: str, name: str) -> None:
    skip_without_avr()

    verdicts = selftest(firmware=partial(CHIPS["avr"], baud=115200), faults=[fault])

    assert name in names_of(verdicts, Result.FAULT)
