"""`board51` commands that a page runs for its readers, for any number of browsers: logs read, models exported.

Rule 1: one process at a time, at a low priority; at most WAITING requests wait for it, further ones are refused.
Rule 2: the process ends with its request: when the browser leaves, at its end, after LIMIT_S, or with this server.
Rule 3: memory is bounded: that of the process, and CHARACTERS of what it prints.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from starlette.requests import Request

from gateway.processes.command import child_words
from gateway.views.hmi.library import LibraryFile
from gateway.views.hmi.model.models import ModelFile
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.texts import text_of

LIMIT_S, CHARACTERS = 120.0, 100_000
WAITING = 8
READ_MEMORY = 2 << 30  # bytes, for logs
EXPORT_MEMORY = 8 << 30  # bytes of address space: numba and scipy reserve more than they use
MAX_BYTES = 200_000_000  # a larger log takes minutes
FORMATS = {"fmu": "FMU", "matlab": "MATLAB", "python": "Python", "modelica": "Modelica", "latex": "LaTeX"}


class Output(NamedTuple):
    """The printed text of a command, and its exit code."""

    text: str
    code: int | None  # None: it was ended after LIMIT_S, or its browser left


class Download(NamedTuple):
    """A file for a browser."""

    name: str
    data: bytes


async def departure(request: Request) -> None:
    """Wait until the client of a request has left; its body must have been read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


class Turns:
    """Runs one command after the other."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._count = 0

    async def summary(self, request: Request, entry: LibraryFile) -> str:
        """Return the summary of a log, as `board51 info` prints it."""
        if entry.bytes > MAX_BYTES:
            return text_of("library.long_to_read", megabytes=f"{entry.bytes / 1e6:.0f}", path=entry.path)
        output = await self.run(request, "info", str(entry.path), memory=READ_MEMORY)
        if output.code is None:
            return text_of("library.too_long_to_read", path=entry.path)
        return output.text.replace(str(entry.path), entry.name)

    async def timeline(self, request: Request, entry: LibraryFile) -> str:
        """Return the timeline of a log as JSON; without marks if it takes too long to read, or too many wait."""
        if entry.bytes <= MAX_BYTES:
            with contextlib.suppress(RefusalError):
                output = await self.run(request, "info", str(entry.path), "--marks", memory=READ_MEMORY)
                if output.code == 0:
                    return output.text
        extent = entry.extent
        if extent is None:
            raise RefusalError("busy", text_of("replay.no_marks"), status=503)
        return json.dumps({"start_s": extent.start_s, "duration_s": extent.duration_s, "marks": []})

    async def sessions(self, request: Request, folder: Path, condition: str) -> str:
        """Return the table of the sessions that satisfy a condition in SQL, as `board51 logs query` does."""
        words = ("logs", "query", "--folder", str(folder), "--quiet", "--", condition)
        output = await self.run(request, *words, memory=READ_MEMORY)
        return text_of("library.many_to_read", path=folder) if output.code is None else output.text

    async def export(self, request: Request, model: ModelFile, to: str) -> Download:
        """Export a model to one of FORMATS, a file for another tool.

        Raises:
            RefusalError: too many requests wait, or it cannot be exported.
        """
        path = _absolute(model)
        with TemporaryDirectory() as folder:
            output = await self.run(request, "export-model", path, "--to", to, memory=EXPORT_MEMORY, folder=folder)
            if output.code != 0:
                lines = output.text.strip().splitlines() or [text_of("models.not_exported")]
                raise RefusalError("not-exported", lines[-1].replace(path, model.name))
            return await asyncio.to_thread(_download, Path(folder))

    async def run(self, request: Request, *command: str, memory: int, folder: str | None = None) -> Output:
        """Run `board51 COMMAND` for a request.

        Args:
            request: whose browser waits; its body must have been read.
            command: the words after `board51`.
            memory: bytes of address space; an interpreter with its libraries takes half a gigabyte.
            folder: in which it runs.

        Raises:
            RefusalError: too many requests wait.
        """
        if self._count > WAITING:
            raise RefusalError("busy", text_of("library.busy"), status=503)
        self._count += 1
        departed = asyncio.create_task(departure(request))
        running = asyncio.create_task(self._run(command, memory, folder))
        try:
            await asyncio.wait({running, departed}, return_when=asyncio.FIRST_COMPLETED)
            return running.result() if running.done() else Output("", None)
        finally:
            self._count -= 1
            departed.cancel()
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running

    async def _run(self, command: tuple[str, ...], memory: int, folder: str | None) -> Output:
        async with self._turn, _process(command, memory, folder) as process:
            assert process.stdout is not None
            try:
                async with asyncio.timeout(LIMIT_S):
                    data, ended = await _up_to(process.stdout, CHARACTERS)
                    code = await process.wait() if ended else None
            except TimeoutError:
                return Output("", None)
        return Output(data.decode("utf-8", errors="replace")[:CHARACTERS], code if ended else 0)


@asynccontextmanager
async def _process(command: tuple[str, ...], memory: int, folder: str | None) -> AsyncIterator[Process]:
    """Run `board51 COMMAND` at a low priority, within `memory` bytes; it ends with the block."""
    process = await asyncio.create_subprocess_exec(
        *child_words(*command), stdin=PIPE, stdout=PIPE, stderr=STDOUT, start_new_session=True, cwd=folder
    )
    try:
        if sys.platform == "linux":
            import resource

            with contextlib.suppress(ProcessLookupError):  # it has ended already
                resource.prlimit(process.pid, resource.RLIMIT_AS, (memory, memory))
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await asyncio.shield(process.wait())


async def _up_to(stream: asyncio.StreamReader, count: int) -> tuple[bytes, bool]:
    """Return (the first `count` bytes, whether these are all)."""
    data = b""
    while len(data) < count:
        if not (chunk := await stream.read(count)):
            return data, True
        data += chunk
    return data, False


def _absolute(model: ModelFile) -> str:
    """The path of a model for a command that runs in another folder."""
    return os.path.abspath(model.path)


def _download(folder: Path) -> Download:
    """The file in this folder, or its folder as an archive."""
    (made,) = folder.iterdir()
    if made.is_dir():
        made = Path(shutil.make_archive(str(made), "zip", folder, made.name))
    return Download(made.name, made.read_bytes())
