"""The comparison sees every field that differs, and says by how much."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.references.__main__ import main
from tests.references.compare import differences

WAS = {
    "verdict": "causes-found",
    "causes": [{"name": "a", "d_m": 1.0}],
    "n": 3,
    "stages_s": {"fit": 1.0},
    "sha256": "x",
}


def test_equal_answers_have_no_differences_and_times_are_no_answer() -> None:
    assert differences(WAS, {**WAS, "stages_s": {"fit": 9.0}}) == []


def test_each_kind_of_change_is_found() -> None:
    changed = {
        "verdict": "unknown-cause",
        "causes": [{"name": "a", "d_m": 1.0 + 1e-15}, {"name": "b"}],
        "n": 3.0,  # a whole number that became a measurement
        "stages_s": {},
        "more": None,
    }

    fields = {change.field for change in differences(WAS, changed)}

    assert fields == {".verdict", ".causes.length", ".causes[0].d_m", ".causes[1].name", ".n", ".more", ".sha256"}


def test_a_tolerance_is_for_measurements_alone() -> None:
    changed = {**WAS, "causes": [{"name": "a", "d_m": 1.0 + 1e-9}], "n": 4, "sha256": "y"}

    assert [str(change) for change in differences(WAS, changed, relative=1e-6)] == [".n: 3 -> 4   (2.5e-01 relative)"]


@pytest.mark.slow
def test_a_tree_that_answers_otherwise_is_told_and_accepted_only_when_asked(tmp_path: Path) -> None:
    twin = ["--recorded", str(tmp_path), "--only", "twin-over-a-log", "--workers", "1"]

    assert main(twin) == 1  # nothing recorded yet
    assert main([*twin, "--accept"]) == 0
    assert main(twin) == 0
