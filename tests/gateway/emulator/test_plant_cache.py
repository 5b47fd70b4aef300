"""Machine code that is kept on disk, when the product is updated in place."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from gateway.emulator.plant import physics
from tests.patience import HANG_S

RUN = """
from {package}.physics import {state}, pull, Constants
numbers = {{name: 1.0 for name in Constants._fields}}
print(pull({state}(*[0.1] * len({state}._fields)), 0.0, Constants(**numbers)))
"""


@pytest.mark.slow
def test_an_update_that_renames_a_class_does_not_stumble_over_older_machine_code(tmp_path: Path) -> None:
    package = tmp_path / "renamed"
    package.mkdir()
    (package / "__init__.py").touch()
    source = Path(physics.__file__).read_text()
    outputs = []
    for state in ("PlantState", "StateOfOld"):
        (package / "physics.py").write_text(source.replace("PlantState", state))
        process = subprocess.run(
            [sys.executable, "-c", RUN.format(package="renamed", state=state)],
            cwd=tmp_path, capture_output=True, text=True, check=False, timeout=HANG_S,
        )  # fmt: skip
        assert process.returncode == 0, process.stderr
        outputs.append(process.stdout)

    assert outputs[0] == outputs[1]
