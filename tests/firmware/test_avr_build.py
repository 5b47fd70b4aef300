"""The image of the ATmega328P is compiled as a careful engineer would, and who has no compiler for it is told so."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from firmware.sim.avr.build import compile_image, load
from gateway.emulator.native.flags import flags
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.patience import HANG_S


@pytest.mark.parametrize("baud", [38400, 115200, 1000000])
def test_it_compiles_without_a_warning(baud: int, tmp_path: Path) -> None:
    skip_without_avr()

    compile_image(tmp_path / "avr.elf", baud=baud, options=flags("WARNINGS"))

    assert {"main", "b51_board", "B51_VIEW"} <= set(load(tmp_path / "avr.elf").symbols)


def test_without_the_compiler_the_command_says_what_to_install(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "board51", "emulate", "--chip", "avr", "--duration", "1"]
    environment = {"PATH": str(tmp_path), "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}

    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S, env=environment)

    assert process.returncode != 0
    assert "avr-gcc is not found" in process.stderr
    assert "gcc-avr" in process.stderr
    assert process.stderr.count("\n") == 1


def test_a_firmware_and_a_chip_are_not_flown_together() -> None:
    command = [sys.executable, "-m", "board51", "emulate", "--chip", "avr", "--firmware", "c"]

    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)

    assert process.returncode == 2
    assert "not allowed with" in process.stderr
