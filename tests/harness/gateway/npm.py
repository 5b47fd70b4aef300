"""Judges from npm: a script of ours with the packages that its package.json names, installed for one test run."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

INSTALL_S = 90.0


def installed(source: Path, folder: Path) -> Path:
    """`folder` with what lies in `source` and its packages; the test is skipped where npm cannot provide them."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    for file in source.iterdir():
        if file.suffix in (".json", ".mjs"):
            shutil.copy(file, folder / file.name)
    command = [npm, "install", "--no-package-lock", "--no-audit", "--no-fund", "--ignore-scripts"]
    try:
        process = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=INSTALL_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm did not answer within {INSTALL_S:g} s")
    if process.returncode:
        pytest.skip(f"the packages cannot be installed: {process.stderr.strip()[-200:]}")
    return folder
