"""`board51 compile`: afterwards nothing is left to compile for a diagnosis, in another process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from board51 import main
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.patience import HANG_S

COUNTING = """
import sys
from numba.core import event
from board51 import main

class Seen(event.Listener):
    names = []
    def on_start(self, one):
        self.names.append(one.data["dispatcher"].py_func.__module__)
    def on_end(self, one):
        pass

event.register("numba:compile", Seen())
code = main(sys.argv[1:])
print(code, sorted({name for name in Seen.names if name.startswith("twin")}))
"""


def compiled(folder: Path, *arguments: str) -> str:
    """The last line of a command that counts: its exit code, and the modules of which a kernel was compiled."""
    process = subprocess.run(
        [sys.executable, "-c", COUNTING, *arguments],
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=True,
    )
    return process.stdout.splitlines()[-1]


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path: Path) -> None:
    make_campaign(tmp_path / "runs", effects={"quadratic-drag": 2.0}, seed=5, plant="independent", quick=True)

    first = compiled(tmp_path / "cache", "compile", "--quiet")
    after = [
        compiled(tmp_path / "cache", *arguments.split(), str(tmp_path / "runs"))
        for arguments in (
            f"identify --quiet --out {tmp_path / 'model.json'}",
            f"validate --model {tmp_path / 'model.json'} --out {tmp_path / 'v'}",
            "diagnose --quick --quiet",
        )
    ]

    assert first.startswith("0 ['twin.")
    assert [line[1:] for line in after] == [" []"] * 3


def test_without_a_place_for_compiled_code_set_up_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twin.compiled.cache_folder", lambda: "")

    assert main(["compile"]) == 0
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().err
