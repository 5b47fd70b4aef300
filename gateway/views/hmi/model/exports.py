"""Models as files for other tools, made by `board51 export-model` when a page asks."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Coroutine
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from gateway.views.hmi.model.models import ModelFile
from gateway.views.hmi.texts import text_of
from gateway.views.hmi.turns import Turns

FORMATS = {"fmu": "FMU", "matlab": "MATLAB", "python": "Python", "modelica": "Modelica", "latex": "LaTeX"}
MEMORY = 8 << 30  # bytes of address space: numba and scipy reserve more than they use


class Download(NamedTuple):
    """A file for a browser, or why there is none."""

    name: str
    data: bytes
    problem: str = ""


async def exported(turns: Turns, model: ModelFile, to: str, leaving: Coroutine[Any, Any, None]) -> Download | None:
    """Export a model; None if too many requests wait.

    Args:
        turns: runs the command.
        model: to export.
        to: of FORMATS.
        leaving: ends when the browser leaves, and the command with it.
    """
    with TemporaryDirectory() as folder:
        path = _absolute(model)
        output = await turns.run("export-model", path, "--to", to, memory=MEMORY, leaving=leaving, folder=folder)
        if output is None:
            return None
        if output.code != 0:
            lines = output.text.strip().splitlines() or [text_of("models.not_exported")]
            return Download("", b"", lines[-1].replace(path, model.name))
        return await asyncio.to_thread(_download, Path(folder))


def _absolute(model: ModelFile) -> str:
    """The path of a model for a command that runs in another folder."""
    return os.path.abspath(model.path)


def _download(folder: Path) -> Download:
    """The file in this folder, or its folder as an archive."""
    (made,) = folder.iterdir()
    if made.is_dir():
        made = Path(shutil.make_archive(str(made), "zip", folder, made.name))
    return Download(made.name, made.read_bytes())
