"""Machine code on disk belongs to the sources that it was made of, callees in other files included."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import twin.compiled
from twin.compiled import sources_hash

CALLEE = "from twin.compiled import kernel\n\n\n@kernel\ndef inner(x: float) -> float:\n    return {factor} * x\n"
CALLER = (
    "from twin.compiled import kernel\nfrom twin.callee import inner\n\n\n"
    "@kernel\ndef outer(x: float) -> float:\n    return inner(x) + 1.0\n"
)


def outer(folder: Path) -> float:
    process = subprocess.run(
        [sys.executable, "-c", "from twin.caller import outer; print(outer(10.0))"],
        cwd=folder,
        env={**{k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(process.stdout)


@pytest.mark.slow
def test_a_kernel_follows_a_change_in_a_file_that_it_calls(tmp_path: Path) -> None:
    package = tmp_path / "twin"
    package.mkdir()
    (package / "__init__.py").touch()
    shutil.copy(Path(twin.compiled.__file__), package / "compiled.py")
    (package / "caller.py").write_text(CALLER)
    (package / "callee.py").write_text(CALLEE.format(factor="2.0"))
    assert outer(tmp_path) == 21.0
    assert len(list((package / "__pycache__").glob("kernels-*"))) == 1

    (package / "callee.py").write_text(CALLEE.format(factor="3.0"))

    assert outer(tmp_path) == 31.0


def test_the_hash_of_the_sources_sees_names_and_contents(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("@kernel\n")
    (tmp_path / "b.py").write_text("pass\n")
    first = sources_hash(tmp_path)
    (tmp_path / "b.py").write_text("no kernel here either\n")
    assert sources_hash(tmp_path) == first
    (tmp_path / "a.py").rename(tmp_path / "c.py")
    assert sources_hash(tmp_path) != first
