"""The notebooks of docs/notebooks run from the first cell to the last, as a reader runs them.

They are scripts with cell marks (`# %%`), not .ipynb: a difference is readable, ruff and mypy read them, and what they
print cannot be older than the program, since nothing of it is kept.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.emulator.serve import Emulator
from gateway.testing import RunningGateway
from tests.patience import HANG_S

NOTEBOOKS = Path(__file__).parents[2] / "docs" / "notebooks"


def run_script(*words: str | Path, folder: Path) -> str:
    process = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=10 * HANG_S,
        check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


@contextmanager
def rig(folder: Path) -> Iterator[RunningGateway]:
    """An emulated board, and a gateway that calls it rig1."""
    with Emulator() as emulator:
        gateway = RunningGateway(folder, [emulator], opcua=False, hmi=False, log=False, config="")
        try:
            gateway.start()
            yield gateway
        finally:
            gateway.stop()


@pytest.mark.slow
def test_subscribe_command_replay(tmp_path: Path) -> None:
    with rig(tmp_path) as gateway:
        output = run_script(NOTEBOOKS / "subscribe_command_replay.py", gateway.endpoint, folder=tmp_path)

    height = re.search(r"after the step the ball is at ([\d.]+) mm", output)
    assert height is not None
    assert float(height.group(1)) == pytest.approx(3.0, abs=0.2)
    assert "set reference was refused by the gateway: out-of-range" in output
    assert "0 dropped" in output
    assert "the same ticks" in output


@pytest.mark.slow
def test_your_first_diagnosis(tmp_path: Path) -> None:
    campaign_folder = tmp_path / "demo-out" / "campaign-1"
    with rig(tmp_path) as gateway:
        words: list[str | Path] = [
            "campaign",
            "run",
            campaign_folder,
            "--board",
            "rig1",
            "--connect",
            gateway.endpoint,
            "--quick",
        ]
        run_script("-m", "board51", *words, folder=tmp_path)

    output = run_script(NOTEBOOKS / "first_diagnosis.py", folder=tmp_path)

    assert "air-gap-offset" in output  # the emulated rig's coil is 2.4 mm higher than the model's
    paper, extended = (float(text) for text in re.findall(r"(?:paper|extended) +([\d.]+) um rms", output))
    assert extended < 0.5 * paper
    assert (tmp_path / "diagnosis" / "report.html").exists()
    assert len(list((tmp_path / "diagnosis").glob("*.png"))) >= 4
