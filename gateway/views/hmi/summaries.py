"""Summaries of logs, as `board51 info` prints them, for any number of browsers.

Rule 1: one process at a time, at a low priority; at most WAITING requests wait for it, further ones are refused.
Rule 2: the process ends with its request: when the browser leaves, at its end, after LIMIT_S, or with this server.
Rule 3: memory is bounded: MEMORY of the process, CHARACTERS of what it prints.
"""

from __future__ import annotations

import asyncio
import contextlib
import resource
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from starlette.requests import Request

from gateway.processes.command import child_words
from gateway.views.hmi.library import LibraryFile
from gateway.views.hmi.texts import text_of

LIMIT_S, CHARACTERS = 120.0, 100_000
MEMORY = 2 << 30  # bytes of address space; an interpreter with its libraries takes a quarter of it
WAITING = 8
MAX_BYTES = 200_000_000  # a larger log takes minutes


async def departure(request: Request) -> None:
    """Wait until the client of a request has left; its body must have been read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


class Summaries:
    """Reads one summary after the other."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._count = 0

    async def text(self, entry: LibraryFile, leaving: Coroutine[Any, Any, None]) -> str | None:
        """Return the summary of a log; None if too many wait.  It ends when `leaving` ends."""
        departed = asyncio.create_task(leaving)
        try:
            if entry.bytes > MAX_BYTES:
                return text_of("library.long_to_read", megabytes=f"{entry.bytes / 1e6:.0f}", path=entry.path)
            if self._count > WAITING:
                return None
            self._count += 1
            reading = asyncio.create_task(self._read(entry))
            try:
                await asyncio.wait({reading, departed}, return_when=asyncio.FIRST_COMPLETED)
                return reading.result() if reading.done() else ""
            finally:
                self._count -= 1
                reading.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await reading
        finally:
            departed.cancel()

    async def _read(self, entry: LibraryFile) -> str:
        async with self._turn, _process("info", str(entry.path)) as process:
            assert process.stdout is not None
            try:
                async with asyncio.timeout(LIMIT_S):
                    data = await _up_to(process.stdout, CHARACTERS)
            except TimeoutError:
                return text_of("library.too_long_to_read", path=entry.path)
        return data.decode("utf-8", errors="replace").replace(str(entry.path), entry.name)[:CHARACTERS]


@asynccontextmanager
async def _process(*command: str) -> AsyncIterator[Process]:
    """Run `board51 COMMAND` at a low priority, within MEMORY; it ends with the block."""
    process = await asyncio.create_subprocess_exec(
        *child_words(*command), stdin=PIPE, stdout=PIPE, stderr=STDOUT, start_new_session=True
    )
    try:
        if sys.platform == "linux":
            with contextlib.suppress(ProcessLookupError):  # it has ended already
                resource.prlimit(process.pid, resource.RLIMIT_AS, (MEMORY, MEMORY))
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await asyncio.shield(process.wait())


async def _up_to(stream: asyncio.StreamReader, count: int) -> bytes:
    data = b""
    while len(data) < count and (chunk := await stream.read(count)):
        data += chunk
    return data
