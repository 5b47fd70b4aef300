"""Checks that firmware/misra.md has each finding of the checker against MISRA C:2012, with its reason, and no other."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from gateway.emulator.native.flags import SOURCES

CHECKER = "Cppcheck 2.10"  # another one counts otherwise
ROW = re.compile(r"^\| (\d+\.\d+) \| (required|advisory) \| ([^|]+) \| ([^|]+) \|$", re.M)


@pytest.mark.slow
def test_each_deviation_has_its_row() -> None:
    rows = ROW.findall((SOURCES / "misra.md").read_text(encoding="utf-8"))
    recorded = {
        (file, rule): int(lines) for rule, _, sites, _ in rows for file, lines in re.findall(r"`([^`]+)` (\d+)", sites)
    }

    assert len(recorded) > 100
    assert all(len(reason) > 20 for *_, reason in rows)
    assert count_deviations() == recorded


def count_deviations() -> dict[tuple[str, str], int]:
    """Return how many lines of a file deviate from a rule."""
    if shutil.which("cppcheck") is None or shutil.which("make") is None:
        pytest.skip("cppcheck or make is not installed")
    version = subprocess.run(["cppcheck", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    if version != CHECKER:
        pytest.skip(f"the record is that of {CHECKER}, and this is {version}")
    command = ["make", "-s", "-C", str(SOURCES), "misra"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return {(file, rule): int(count) for count, file, rule in map(str.split, lines)}
