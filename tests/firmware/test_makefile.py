"""`firmware/Makefile` builds without Python what the Python side builds: the same bytes by the same flags."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware.sim.avr.build import hex_of
from firmware.sim.mcs51.build import build_image, code_of
from gateway.emulator.native.build import build_of_sources
from gateway.emulator.native.flags import SOURCES, flags
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import skip_without_compiler

PRODUCT = [SOURCES.parent / "gateway", SOURCES]


def make(folder: Path, *words: str) -> str:
    """Let make build into `folder`; return what it prints."""
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    build = build_of_sources().decode().rstrip()
    command = ["make", "-s", "-C", str(SOURCES), f"OUT={folder}", f"BUILD={build}", *words]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("skip", "goal", "name"),
    [
        (skip_without_avr, "avr", "atmega328p"),
        (skip_without_avr, "avr", "magnetoshield"),
        (skip_without_sdcc, "mcs51", "aduc841"),
    ],
)
def test_an_image_by_make_is_that_by_python(skip: Callable[[], None], goal: str, name: str, tmp_path: Path) -> None:
    skip()
    make(tmp_path / "out", goal)
    made = code_of((tmp_path / "out" / f"{name}.hex").read_text(encoding="ascii"))

    if goal == "avr":
        hex_of(tmp_path / "ours.hex", profile=f"{name}.h" if name == "magnetoshield" else "")
        expected = code_of((tmp_path / "ours.hex").read_text(encoding="ascii"))
    else:
        build_image(tmp_path / "ours.json")
        expected = bytes.fromhex(json.loads((tmp_path / "ours.json").read_text(encoding="utf-8"))["code"])

    assert made == expected


@pytest.mark.slow
def test_the_library_builds_and_the_sanitizers_find_nothing(tmp_path: Path) -> None:
    skip_without_compiler()

    output = make(tmp_path, "posix", "sanitize")

    assert (tmp_path / "firmware.so").exists()
    ticks = [int(number) for number in re.findall(r"(\d+)", output)]
    assert sum(ticks) == 200_000
    assert min(ticks) > 2_000  # in each mode


def test_no_flag_stands_in_python() -> None:
    """Of those that decide what a chip computes and has room for."""
    telling = {flag for flag in flags("AVR_FLAGS", "MCS51_FLAGS", "AVR_CONFIG", "MCS51_CONFIG") if len(flag) > 6}
    occurrences = {
        (path.name, flag)
        for folder in PRODUCT
        for path in folder.rglob("*.py")
        for flag in telling
        if flag in path.read_text(encoding="utf-8")
    }

    assert occurrences == set()
