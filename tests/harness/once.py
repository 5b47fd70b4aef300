"""Things that are slow to make are made once for all processes of a run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a path that the first process of the run makes and the others read."""
    if sys.platform == "win32":  # each makes its own there
        path = factory.mktemp("own") / name
        make(path)
        return path
    import fcntl

    base = factory.getbasetemp()
    folder = base.parent if base.name.startswith("popen-") else base  # pytest-xdist: a folder for each process
    with (folder / f"{name}.made").open("a+") as made:
        fcntl.flock(made, fcntl.LOCK_EX)  # closing the file lets it go
        if not made.seek(0, 2):
            make(folder / name)
            made.write("yes")
    return folder / name
