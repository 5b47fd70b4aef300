"""`board51` commands that a page runs for its readers, for any number of browsers.

Rule 1: one process at a time, at a low priority; at most WAITING requests wait for it, further ones are refused.
Rule 2: the process ends with its request: when the browser leaves, at its end, after LIMIT_S, or with this server.
Rule 3: memory is bounded: that of the process, and CHARACTERS of what it prints.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

from starlette.requests import Request

from gateway.processes.command import child_words

LIMIT_S, CHARACTERS = 120.0, 100_000
WAITING = 8


class Output(NamedTuple):
    """The printed text of a command, and its exit code."""

    text: str
    code: int | None  # None: it was ended after LIMIT_S, or its browser left


async def departure(request: Request) -> None:
    """Wait until the client of a request has left; its body must have been read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


class Turns:
    """Runs one command after the other."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._count = 0

    async def run(
        self, *command: str, memory: int, leaving: Coroutine[Any, Any, None], folder: str | None = None
    ) -> Output | None:
        """Run `board51 COMMAND`; None if too many wait.

        Args:
            command: the words after `board51`.
            memory: bytes of address space; an interpreter with its libraries takes half a gigabyte.
            leaving: ends when the browser leaves, and the command with it.
            folder: in which it runs.
        """
        departed = asyncio.create_task(leaving)
        try:
            if self._count > WAITING:
                return None
            self._count += 1
            running = asyncio.create_task(self._run(command, memory, folder))
            try:
                await asyncio.wait({running, departed}, return_when=asyncio.FIRST_COMPLETED)
                return running.result() if running.done() else Output("", None)
            finally:
                self._count -= 1
                running.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await running
        finally:
            departed.cancel()

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
