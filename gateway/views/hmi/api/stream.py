"""The WebSocket of one rig's samples: a message for each, evenly decimated.

Rule 1: of each interval of 1 / rate_hz the last sample is sent, by the board's ticks; at the rate of the board all are.
Rule 2: a client that reads too slowly misses the oldest samples, and `tick` tells; one that takes nothing for STUCK_S
        is cut off.
Rule 3: samples go out only while the session is open.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

from pydantic import TypeAdapter
from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.views.feed import BoardFeed, Feed
from gateway.views.hmi.api import rigs, shapes
from gateway.views.hmi.api.queries import StreamQuery
from gateway.views.hmi.api.resource import checked_form
from gateway.views.hmi.guard import PROTOCOL, SESSION_OVER
from gateway.views.hmi.live import FRAME_S, STUCK_S
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from protocol.bus import board51_pb2 as pb
from protocol.errors import Board51Error

MAX_STREAMS = 32
NO_RIG, BAD_QUERY, TOO_MANY = 4404, 4400, 1013  # WebSocket close codes
_STATE = TypeAdapter(shapes.State)


class Streams:
    """The WebSockets of one server.

    Args:
        feed: of the live site.
        sessions: who may read.
    """

    def __init__(self, feed: Feed, sessions: LoginSessions) -> None:
        self._feed, self._sessions = feed, sessions
        self._count = 0

    async def stream(self, socket: WebSocket) -> None:
        """Serve one client until it leaves."""
        offered = socket.scope.get("subprotocols", [])
        await socket.accept(subprotocol=PROTOCOL if PROTOCOL in offered else None)
        board = self._feed.board(socket.path_params["rig"])
        if board is None:
            known = ", ".join(self._feed.boards()) or "none yet"
            await socket.close(NO_RIG, _reason(f"No such rig. The rigs are: {known}"))
            return
        try:
            query: StreamQuery = checked_form(StreamQuery, socket.query_params.multi_items(), where="query")
        except Board51Error as error:
            await socket.close(BAD_QUERY, _reason(str(error)))
            return
        if self._count >= MAX_STREAMS:
            await socket.close(TOO_MANY, "Too many streams are open")
            return
        self._count += 1
        leaving = asyncio.create_task(_departure(socket))
        try:
            await self._send(socket, board, query, leaving)
        except (WebSocketDisconnect, TimeoutError, RuntimeError):
            pass  # the client left or does not read: only its stream ends
        finally:
            self._count -= 1
            leaving.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await leaving

    async def _send(self, socket: WebSocket, board: BoardFeed, query: StreamQuery, leaving: asyncio.Task[None]) -> None:
        session: LoginSession = socket.scope["board51_session"]
        text: Callable[[shapes.State], str] = rigs.csv_line if query.format == "csv" else _json
        if query.format == "csv":
            await asyncio.wait_for(socket.send_text(rigs.HEADER), STUCK_S)
        tap = board.tap(pb.State, width_s=1.0 / query.rate_hz)
        try:
            while not leaving.done():
                now_s = time.monotonic()
                if not self._sessions.is_open(session, now_s):
                    await asyncio.wait_for(socket.close(SESSION_OVER), STUCK_S)
                    return
                for closed in tap.take():
                    sample = rigs.state(closed.message, lost=closed.lost)
                    await asyncio.wait_for(socket.send_text(text(sample)), STUCK_S)
                await asyncio.wait({leaving}, timeout=FRAME_S)
        finally:
            board.detach(pb.State, tap)


def _json(sample: shapes.State) -> str:
    return _STATE.dump_json(sample).decode()


def _reason(text: str) -> str:
    """Return a text that fits into a close frame: 123 bytes."""
    return text.encode("ascii", errors="replace")[:120].decode("ascii")


async def _departure(socket: WebSocket) -> None:
    """Wait until a client has left; what it sends is dropped."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
