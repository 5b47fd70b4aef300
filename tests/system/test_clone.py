"""A clone of the repository stays clean: what commands write into the current folder is ignored by git."""

from __future__ import annotations

import argparse
import importlib
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import board51

ROOT = Path(__file__).parents[2]


def default_folders() -> Iterator[str]:
    """Relative folders that commands write into, or read, unless an option says otherwise."""
    yield "investigation-rig1"  # of `investigate`: its default has the name of the rig
    for module, _ in board51.COMMANDS.values():
        waiting = [argparse.ArgumentParser()]
        importlib.import_module(module).configure(waiting[0])
        while waiting:
            for action in waiting.pop()._actions:
                if isinstance(action, argparse._SubParsersAction):
                    waiting.extend(action.choices.values())
                elif isinstance(action.default, Path) and not action.default.is_absolute():
                    yield str(action.default)


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs git and a clone")
def test_what_commands_write_into_the_current_folder_is_ignored() -> None:
    folders = set(default_folders())
    assert {"logs", "hmi-data", "demo-out"} <= folders

    files = [f"{folder}/file" for folder in sorted(folders)]
    ignored = subprocess.run(["git", "check-ignore", *files], cwd=ROOT, capture_output=True, text=True, check=False)

    assert ignored.stdout.split() == files
    tracked = subprocess.run(["git", "ls-files", "--", *folders], cwd=ROOT, capture_output=True, text=True, check=True)
    assert tracked.stdout == "", "no folder of the repository has such a name"
