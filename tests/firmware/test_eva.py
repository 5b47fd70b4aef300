"""Checks that firmware/eva.md has each finding of the analysis of values in the core, with its reason, and no other."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.emulator.native.flags import SOURCES

ROW = re.compile(r"^\| `(eva_\w+)` \| [^|]+ \| (\d+) \| ([^|]*)\|$", re.M)
RECORDED = ROW.findall((SOURCES / "eva.md").read_text(encoding="utf-8"))


def test_each_alarm_has_its_reason() -> None:
    entries = re.findall(r"^void (eva_\w+)", (SOURCES / "verify" / "eva.c").read_text(encoding="utf-8"), re.M)

    assert [entry for entry, _, _ in RECORDED] == entries
    assert all((int(alarms) > 0) == (len(reason) > 20) for _, alarms, reason in RECORDED)


@pytest.mark.slow
def test_no_other_alarm_is_found(tmp_path: Path) -> None:
    if shutil.which("frama-c") is None or shutil.which("make") is None:
        pytest.skip("frama-c (Debian: frama-c-base, 860 MB) or make is not installed")
    command = ["make", "-s", "-C", str(SOURCES), f"OUT={tmp_path}", "eva"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()

    assert lines == [f"{entry} {alarms}" for entry, alarms, _ in RECORDED]
