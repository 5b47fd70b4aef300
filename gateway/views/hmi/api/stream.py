"""The WebSockets of one rig: a message for each sample, evenly decimated, or for each event and change of an alarm.

Rule 1: of each interval of 1 / rate_hz the last sample is sent, by the board's ticks; at the rate of the board all are.
Rule 2: a client that reads too slowly misses the oldest samples, and `tick` tells; one that takes nothing for STUCK_S
        is cut off.
Rule 3: samples go out only while the session is open.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Any

from pydantic import TypeAdapter
from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.views.board_feed import RETAINED_EVENTS, BoardFeed
from gateway.views.feed import Feed
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
_OVER: dict[str, Any] = {"active": False, "acknowledged": True, "shelved_until_s": None}
_STATE, _NOTICE = TypeAdapter(shapes.State), TypeAdapter(shapes.Notice)
Source = Generator[list[str], None, None]  # of the messages since the last look


class Streams:
    """The WebSockets of one server.

    Args:
        feed: of the live site.
        sessions: who may read.
    """

    def __init__(self, feed: Feed, sessions: LoginSessions) -> None:
        self._feed, self._sessions = feed, sessions
        self._count = 0

    async def samples(self, socket: WebSocket) -> None:
        """Send samples to one client until it leaves."""
        await self._serve(socket, StreamQuery, _samples)

    async def events(self, socket: WebSocket) -> None:
        """Send events and alarms to one client until it leaves."""
        await self._serve(socket, None, _notices)

    async def _serve(
        self, socket: WebSocket, query_type: type | None, source: Callable[[BoardFeed, Any], Source]
    ) -> None:
        offered = socket.scope.get("subprotocols", [])
        await socket.accept(subprotocol=PROTOCOL if PROTOCOL in offered else None)
        board = self._feed.board(socket.path_params["rig"])
        if board is None:
            known = ", ".join(self._feed.boards()) or "none yet"
            await socket.close(NO_RIG, _reason(f"No such rig. The rigs are: {known}"))
            return
        try:
            query = checked_form(query_type, socket.query_params.multi_items(), where="query")
        except Board51Error as error:
            await socket.close(BAD_QUERY, _reason(str(error)))
            return
        if self._count >= MAX_STREAMS:
            await socket.close(TOO_MANY, "Too many streams are open")
            return
        self._count += 1
        leaving = asyncio.create_task(_departure(socket))
        try:
            with contextlib.closing(source(board, query)) as texts:
                await self._send(socket, texts, leaving)
        except (WebSocketDisconnect, TimeoutError, RuntimeError):
            pass  # the client left or does not read: only its stream ends
        finally:
            self._count -= 1
            leaving.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await leaving

    async def _send(self, socket: WebSocket, source: Source, leaving: asyncio.Task[None]) -> None:
        session: LoginSession = socket.scope["board51_session"]
        while not leaving.done():
            if not self._sessions.is_open(session, time.monotonic()):
                await asyncio.wait_for(socket.close(SESSION_OVER), STUCK_S)
                return
            for text in next(source):
                await asyncio.wait_for(socket.send_text(text), STUCK_S)
            await asyncio.wait({leaving}, timeout=FRAME_S)


def _samples(board: BoardFeed, query: StreamQuery) -> Source:
    text: Callable[[shapes.State], str] = rigs.csv_line if query.format == "csv" else _json
    tap = board.tap(pb.State, width_s=1.0 / query.rate_hz)
    try:
        yield [rigs.HEADER] if query.format == "csv" else []
        while True:
            yield [text(rigs.state(closed.message, lost=closed.lost)) for closed in tap.take()]
    finally:
        board.detach(pb.State, tap)


class _Arrived:
    """The events that came since the last look; of too many the oldest are lost."""

    def __init__(self) -> None:
        self.events: deque[pb.Event] = deque(maxlen=RETAINED_EVENTS)
        self.push = self.events.append


def _notices(board: BoardFeed, _: None) -> Source:
    arrived, revision = _Arrived(), -1
    sent: dict[str, shapes.AlarmEntry] = {}
    board.attach(pb.Event, arrived)
    try:
        while True:
            notices = [shapes.Notice(event=rigs.event(arrived.events.popleft())) for _ in range(len(arrived.events))]
            if board.alarms_revision() != revision:
                revision = board.alarms_revision()
                listed = {alarm.name: alarm for alarm in rigs.alarms(board)}
                over = [replace(sent[name], **_OVER) for name in sent.keys() - listed.keys()]
                changed = [alarm for name, alarm in listed.items() if sent.get(name) != alarm]
                notices += [shapes.Notice(alarm=alarm) for alarm in (*over, *changed)]
                sent = listed
            yield [_NOTICE.dump_json(notice).decode() for notice in notices]
    finally:
        board.detach(pb.Event, arrived)


def _json(sample: shapes.State) -> str:
    return _STATE.dump_json(sample).decode()


def _reason(text: str) -> str:
    """Return a text that fits into a close frame: 123 bytes."""
    return text.encode("ascii", errors="replace")[:120].decode("ascii")


async def _departure(socket: WebSocket) -> None:
    """Wait until a client has left; drop all that it sends."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
