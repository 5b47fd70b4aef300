"""The core is C for the compilers of its chips, too: it compiles there without a warning, and an AVR computes the same.

Compilers and simulator are not needed for anything else (Debian: gcc-avr avr-libc simavr, sdcc), so without them these
tests are skipped.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.emulator.native.build import SOURCES
from gateway.emulator.native.build import compiler as native_compiler
from tests.harness.gateway.board_host import skip_without_compiler
from tests.patience import HANG_S

CORE = sorted(SOURCES.glob("core/*.c"))
SMALL = ("-DCAPTURE_SIZE=256U", "-DCAPTURE_US=200U", "-DANSWER_DEPTH=2U", "-DEVENT_DEPTH=6U", "-DBLOCK_DEPTH=1U")
STRICT = ("-std=gnu99", "-Os", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")
COMMANDS = {
    "avr-gcc": ("-mmcu=atmega328p", *STRICT, *SMALL, "-fstack-usage"),
    "sdcc": ("-mmcs51", "--std-c99", "--model-small"),
}


@pytest.mark.parametrize("source", CORE, ids=lambda path: path.name)
@pytest.mark.parametrize("compiler", COMMANDS)
def test_the_core_compiles_for_the_chip(compiler: str, source: Path, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")

    out = tmp_path / f"{source.stem}.rel"
    command = [compiler, *COMMANDS[compiler], "-c", str(source), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    assert done.stdout + done.stderr == ""
    assert out.exists()


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="avr-gcc is not installed")
def test_the_state_fits_the_ram_of_an_atmega328p_with_shorter_queues(tmp_path: Path) -> None:
    out = tmp_path / "board.o"
    subprocess.run(
        ["avr-gcc", *COMMANDS["avr-gcc"], "-c", str(SOURCES / "core/board.c"), "-o", str(out)], check=True, cwd=tmp_path
    )

    symbols = subprocess.run(["avr-nm", "-S", str(out)], capture_output=True, text=True, check=True).stdout
    size = next(int(line.split()[1], 16) for line in symbols.splitlines() if line.endswith(" board"))

    assert size < 2048 - 256  # what is left is for the stack and the target's own


@pytest.mark.skipif(
    shutil.which("avr-gcc") is None or shutil.which("simavr") is None, reason="avr-gcc or simavr is not installed"
)
def test_an_avr_does_what_this_machine_does_over_2000_ticks(tmp_path: Path) -> None:
    """`int` has 16 bits there; simavr runs an ATmega1284P, whose RAM holds the queues as they are."""
    skip_without_compiler()
    sources = [str(Path(__file__).parent / "chip" / "play.c"), *map(str, CORE)]
    include = f"-I{SOURCES / 'core'}"
    here, there = tmp_path / "here", tmp_path / "there.elf"
    subprocess.run([str(native_compiler()), "-std=c99", "-O2", include, *sources, "-o", str(here)], check=True)
    subprocess.run(
        ["avr-gcc", "-mmcu=atmega1284p", "-std=gnu99", "-Os", include, *sources, "-o", str(there)], check=True
    )

    expected = subprocess.run([str(here)], capture_output=True, text=True, check=True).stdout.split()
    command = ["simavr", "-m", "atmega1284p", "-f", "16000000", str(there)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=HANG_S)

    assert int(expected[1], 16) > 20_000  # bytes sent
    assert " ".join(expected) in done.stdout + done.stderr
