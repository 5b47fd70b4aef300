"""Summaries and timelines of logs, as `board51 info` prints them; sessions, as `board51 logs query` does."""

from __future__ import annotations

import json
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from gateway.views.hmi.library import LibraryFile
from gateway.views.hmi.texts import text_of
from gateway.views.hmi.turns import Turns

MEMORY = 2 << 30  # bytes
MAX_BYTES = 200_000_000  # a larger log takes minutes


async def summary(turns: Turns, entry: LibraryFile, leaving: Coroutine[Any, Any, None]) -> str | None:
    """Return the summary of a log; None if too many wait.  It ends when `leaving` ends."""
    if entry.bytes > MAX_BYTES:
        leaving.close()
        return text_of("library.long_to_read", megabytes=f"{entry.bytes / 1e6:.0f}", path=entry.path)
    output = await turns.run("info", str(entry.path), memory=MEMORY, leaving=leaving)
    if output is None:
        return None
    if output.code is None:
        return text_of("library.too_long_to_read", path=entry.path)
    return output.text.replace(str(entry.path), entry.name)


async def timeline(turns: Turns, entry: LibraryFile, leaving: Coroutine[Any, Any, None]) -> str | None:
    """Return the timeline of a log as JSON; without marks if it takes too long to read; None if nothing is known."""
    if entry.bytes > MAX_BYTES:
        leaving.close()
    else:
        output = await turns.run("info", str(entry.path), "--marks", memory=MEMORY, leaving=leaving)
        if output is not None and output.code == 0:
            return output.text
    extent = entry.extent
    if extent is None:
        return None
    return json.dumps({"start_s": extent.start_s, "duration_s": extent.duration_s, "marks": []})


async def sessions(turns: Turns, folder: Path, condition: str, leaving: Coroutine[Any, Any, None]) -> str | None:
    """Return the table of the sessions that satisfy a condition in SQL; None if too many wait."""
    words = ("logs", "query", "--folder", str(folder), "--quiet", "--", condition)
    output = await turns.run(*words, memory=MEMORY, leaving=leaving)
    if output is None:
        return None
    return text_of("library.many_to_read", path=folder) if output.code is None else output.text
