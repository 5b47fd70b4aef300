"""The core is C for the compilers of its chips, too: it compiles there without a warning.

What the chips compute with it is compared in test_avr_same_frames.py and test_mcs51_same_frames.py.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.emulator.native.flags import SOURCES, flags

CORE = sorted(SOURCES.glob("core/*.c"))
COMMANDS = {
    "avr-gcc": flags("AVR_FLAGS", "WARNINGS", "AVR_CONFIG"),
    "sdcc": flags("MCS51_FLAGS", "MCS51_WARNINGS", "MCS51_CONFIG"),
}


@pytest.mark.parametrize("source", CORE, ids=lambda path: path.name)
@pytest.mark.parametrize("compiler", COMMANDS)
def test_the_core_compiles_for_the_chip(compiler: str, source: Path, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")

    out = tmp_path / f"{source.stem}.rel"
    command = [compiler, *COMMANDS[compiler], "-c", str(source), "-o", str(out)]
    process = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)

    assert process.returncode == 0, process.stderr
    assert process.stdout + process.stderr == ""
    assert out.exists()
