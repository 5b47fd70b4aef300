"""`make demo` and `make test` keep what they make in the clone, and read nothing that lies in the developer's home."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CACHES = ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR", "npm_config_cache")
OUTSIDE = {name: "/outside" for name in (*CACHES, "NUMBA_CACHE_DIR")}


@pytest.mark.parametrize(("target", "program"), [("demo", "board51"), ("test", "pytest"), ("test-slow", "pytest")])
def test_caches_lie_in_the_clone(target: str, program: str, tmp_path: Path) -> None:
    (tmp_path / program).write_text("#!/bin/sh\nenv\n", encoding="utf-8")
    (tmp_path / program).chmod(0o755)

    process = subprocess.run(
        [
            "make",
            "--silent",
            "--no-print-directory",
            "--assume-old=setup",
            "--assume-old=install",
            target,
            f"BIN={tmp_path}",
        ],
        cwd=ROOT,
        env={**os.environ, **OUTSIDE},
        capture_output=True,
        text=True,
        check=True,
    )

    environment = dict(line.split("=", 1) for line in process.stdout.splitlines() if "=" in line)
    assert all(Path(environment[name]).is_relative_to(ROOT / ".venv") for name in CACHES)
    assert "NUMBA_CACHE_DIR" not in environment
