"""The WebSockets of one rig: a message for each sample, evenly decimated, or for each event and change of an alarm.

Rule 1: of each interval of 1 / rate_hz the last sample is sent, by the board's ticks; at the rate of the board all are.
Rule 2: a client that reads too slowly misses the oldest samples, and `tick` tells.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Generator
from typing import Any

from pydantic import TypeAdapter
from starlette.websockets import WebSocket

from gateway.views.board_feed import RETAINED_EVENTS, BoardFeed
from gateway.views.feed import Feed
from gateway.views.hmi.api import rigs, shapes
from gateway.views.hmi.api.forms import StreamQuery
from gateway.views.hmi.api.resource import checked_form
from gateway.views.hmi.guard import PROTOCOL
from gateway.views.hmi.live import FRAME_S, pour
from gateway.views.hmi.sessions import LoginSessions
from protocol.bus import board51_pb2 as pb
from protocol.errors import Board51Error

MAX_STREAMS = 32
NO_RIG, BAD_QUERY, TOO_MANY = 4404, 4400, 1013  # WebSocket close codes
_OVER: dict[str, Any] = {"active": False, "acknowledged": True, "shelved_until_s": None}
_STATE: TypeAdapter[Any] = TypeAdapter(shapes.State)
_NOTICE: TypeAdapter[Any] = TypeAdapter(shapes.Notice)
Source = Generator[list[str], None, None]  # of the messages since the last look


class Streams:
    """The WebSockets of one server."""

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
        try:
            with contextlib.closing(source(board, query)) as texts:
                await pour(socket, self._sessions, lambda _: next(texts), FRAME_S)
        finally:
            self._count -= 1


def _samples(board: BoardFeed, query: StreamQuery) -> Source:
    text: Callable[[rigs.Table], str] = rigs.csv_line if query.format == "csv" else _json
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
    sent: dict[str, rigs.Table] = {}
    board.attach(pb.Event, arrived)
    try:
        while True:
            events = [rigs.event(arrived.events.popleft()) for _ in range(len(arrived.events))]
            notices: list[rigs.Table] = [{"event": event, "alarm": None} for event in events]
            if board.alarms_revision() != revision:
                revision = board.alarms_revision()
                listed = {alarm["name"]: alarm for alarm in rigs.alarms(board)}
                over = [sent[name] | _OVER for name in sent.keys() - listed.keys()]
                changed = [alarm for name, alarm in listed.items() if sent.get(name) != alarm]
                notices += [{"event": None, "alarm": alarm} for alarm in (*over, *changed)]
                sent = listed
            yield [_NOTICE.dump_json(notice).decode() for notice in notices]
    finally:
        board.detach(pb.Event, arrived)


def _json(sample: rigs.Table) -> str:
    return _STATE.dump_json(sample).decode()


def _reason(text: str) -> str:
    """Return a text that fits into a close frame: 123 bytes."""
    return text.encode("ascii", errors="replace")[:120].decode("ascii")
