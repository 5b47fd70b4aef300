"""The requests of one OPC UA connection: a request that waits for a board delays no other.

asyncua handles the requests of a connection one after the other.  A write to a board that does not answer takes
seconds, and a STOP behind it would wait as long.  A SCADA system has one connection for all of its rigs.
"""

from __future__ import annotations

import asyncio
from typing import Any

from asyncua import ua
from asyncua.server import binary_server_asyncio
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import nodeid_from_binary

MAX_ACTS = 64  # of one connection at once; further requests wait for one of them
_ACTS = (
    ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary),
    ua.NodeId(ua.ObjectIds.WriteRequest_Encoding_DefaultBinary),
)


class PromptProcessor(UaProcessor):  # type: ignore[misc]  # asyncua's class is untyped
    """Handles each call and write in a task of its own, which ends with the connection."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._acts: set[asyncio.Task[Any]] = set()

    async def process_message(self, seqhdr: Any, body: Any) -> Any:
        """Handle one request; returns whether the connection stays."""
        if self.session is None or nodeid_from_binary(body.copy()) not in _ACTS:
            return await super().process_message(seqhdr, body)
        if len(self._acts) >= MAX_ACTS:
            await asyncio.wait(self._acts, return_when=asyncio.FIRST_COMPLETED)
        task = asyncio.create_task(super().process_message(seqhdr, body))
        self._acts.add(task)
        task.add_done_callback(self._acts.discard)
        return True

    async def close(self) -> None:
        """Give up what has not begun: its client has left."""
        for task in self._acts:
            task.cancel()
        await super().close()


def install() -> None:
    """Make asyncua's connections use it: asyncua offers no other way to choose the class."""
    binary_server_asyncio.UaProcessor = PromptProcessor
