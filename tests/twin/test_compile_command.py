"""`board51 compile`: afterwards nothing is left to compile for a diagnosis, in another process."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from board51 import main
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.patience import HANG_S

LISTING = """
import gc, json, sys
from numba.core.dispatcher import Dispatcher
from board51 import main

code = main(sys.argv[1:])
made = {
    f"{one.py_func.__module__}.{one.py_func.__name__}{signature}"
    for one in gc.get_objects() if issubclass(type(one), Dispatcher) and one.py_func.__module__.startswith("twin")
    for signature in one.overloads
}
print(json.dumps([code, sorted(made)]))
"""


def kernels_of(*arguments: object) -> tuple[int, set[str]]:
    """Run a command in another process.

    Returns its exit code and the kernels that Python called, with the types of their arguments.  From the disk or
    compiled: both are in memory then, so the test does not have to compile all of them in an empty folder.
    """
    words = [sys.executable, "-c", LISTING, *map(str, arguments)]
    process = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=True)
    code, made = json.loads(process.stdout.splitlines()[-1])
    return code, set(made)


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path: Path) -> None:
    folder, model = tmp_path / "runs", tmp_path / "model.json"
    make_campaign(folder, effects={"quadratic-drag": 2.0}, seed=5, plant="independent", quick=True)

    code, prepared = kernels_of("compile", "--quiet")
    needed = [
        kernels_of(*arguments, folder)[1]
        for arguments in (
            ("identify", "--quiet", "--out", model),
            ("validate", "--model", model, "--out", tmp_path / "v"),
            ("diagnose", "--quick", "--quiet"),
            (
                "what-if",
                folder / "closed_loop_1.csv.gz",
                "--model",
                model,
                "--reference",
                folder / "closed_loop_2.csv.gz",
                "--campaign",
            ),
        )
    ]

    assert code == 0
    assert all(needed)
    assert set.union(*needed) - prepared == set()


def test_without_a_place_for_compiled_code_set_up_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twin.compiled.cache_folder", lambda: "")

    assert main(["compile"]) == 0
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().err
