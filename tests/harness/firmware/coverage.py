"""Lines and branches of the core that the tests reach, by file, and those that they do not: `python -m` this.

Played are a minute of a random host against the model in Python, frames that are nearly right, and the tests of rules.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from gateway.emulator.native import board as native_board
from gateway.emulator.native.build import compile_to
from gateway.emulator.native.flags import SOURCES
from tests.firmware.test_core_law import fly_both
from tests.harness.firmware.core import Core
from tests.harness.firmware.fuzz import fuzz
from tests.harness.firmware.mutants import RULES
from tests.harness.firmware.random_host import play

OPTIONS = ("--coverage", "-O0")


def exercise(library: Path) -> None:
    """Play everything on a library."""
    for seed in range(19, 23):
        play(seed, 7_500, path=library)
    fuzz(1, 20_000, library)
    vars(native_board)["library"] = lambda: library
    pytest.main(["-q", "-n0", "-p", "no:cacheprovider", *RULES, "tests/gateway/emulator/test_firmware_once.py"])
    from tests.firmware import test_core_arithmetic as arithmetic  # hypothesis may not be here before pytest

    core = Core(library)
    fly_both(core, 1, 6_000)
    arithmetic.test_sums_saturate(core=core)
    arithmetic.test_a_signal_is_that_of_python(core=core)
    arithmetic.test_a_long_chirp_downwards_keeps_its_phase(core)


def main() -> int:
    """Print the table, and each branch that was not taken."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = folder / "firmware.so"
        compile_to(library, options=OPTIONS)
        subprocess.run([sys.executable, "-m", __spec__.name, str(library)], check=True, stdout=subprocess.DEVNULL)
        notes = sorted(map(str, folder.glob("*.gcda")))
        output = subprocess.run(
            ["gcov", "-b", "-j", "-t", *notes], cwd=folder, check=True, capture_output=True, text=True
        ).stdout
    total = [0, 0, 0, 0]
    missed: list[str] = []
    for document in output.splitlines():
        for file in json.loads(document)["files"]:
            path = Path(file["file"])
            if path.parent != SOURCES / "core" or path.suffix != ".c":
                continue
            lines = file["lines"]
            branches = [(line["line_number"], branch["count"]) for line in lines for branch in line["branches"]]
            row = [sum(line["count"] > 0 for line in lines), len(lines), sum(n > 0 for _, n in branches), len(branches)]
            total = [a + b for a, b in zip(total, row, strict=True)]
            print(f"| `{path.name}` | {row[0]} of {row[1]} | {row[2]} of {row[3]} |")
            text = path.read_text(encoding="utf-8").splitlines()
            missed += [f"{path.name}:{at}: {text[at - 1].strip()}" for at in sorted({a for a, n in branches if n == 0})]
    print(f"| all | {total[0]} of {total[1]} | {total[2]} of {total[3]} |", *missed, sep="\n")
    return 0


if __name__ == "__main__":
    if len(sys.argv) == 2:
        exercise(Path(sys.argv[1]))
    else:
        sys.exit(main())
