"""Sends frames to a browser, 30 per second, as long as it reads them.

Rule 1: the newest frame wins.  A frame is made when the last one has gone out, so a slow browser gets fewer frames and
        memory holds one.  Rows that it missed come with the next frame, as far as the ring of `traces.py` reaches.
Rule 2: a client that takes nothing for STUCK_S is cut off.
Rule 3: texts go out only while the session is open.
Rule 4: a frame says when it was made, by this server's clock: with it a page dates what it sends, see requests.py.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.views.board_feed import BoardFeed
from gateway.views.feed import Feed
from gateway.views.hmi import snapshot
from gateway.views.hmi.guard import PROTOCOL, SESSION_OVER
from gateway.views.hmi.jobs import Job
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from gateway.views.hmi.traces import Traces
from gateway.views.hmi.watch import Watch
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import card_plant
from protocol.errors import DataError
from protocol.files import parse_json

FRAME_S = 1.0 / 30.0
REST_S = 0.25  # interval at which lists and health are checked; they are sent when they have changed
OVERVIEW_S = 0.2
SPECTRUM_S = 1.0
STUCK_S = 10.0
MAX_READERS = 64
_MARGIN = 1.1  # of the drawing above the highest reference, if the travel is not known


async def follow(feed: Feed, period_s: float, do: Callable[[BoardFeed], object]) -> None:
    """Do something with every board of a feed, whether or not somebody looks; runs until it is cancelled."""
    while True:
        for board in feed.board_feeds():
            do(board)
        await asyncio.sleep(period_s)


def travel_m(board: BoardFeed) -> float | None:
    """Return the travel of the ball that a drawing of a board shows; None where nothing is known."""
    plant = card_plant(board.latest(pb.PlantCard))
    if plant is not None:
        return plant.travel_m
    model, parameters = board.latest(pb.TwinModel), board.latest(pb.Parameters)
    model_travel_m = travel_of(model.model_json) if model is not None else math.nan
    if math.isfinite(model_travel_m):
        return model_travel_m
    return None if parameters is None else parameters.x_ref_max_m * _MARGIN


@lru_cache(maxsize=64)
def travel_of(model_json: str) -> float:
    """The way between the stops that a model file tells, m; NaN where it does not."""
    try:
        value = parse_json(model_json, where="the twin's model")["plant"]["travel_m"]
        return float(value) if 0.0 < float(value) < 1.0 else math.nan
    except (DataError, ValueError, TypeError, KeyError):
        return math.nan


class Live:
    """Serves the WebSockets of one feed.

    Args:
        feed: what to show.
        sessions: who may look.
        jobs: of a rig; on pages of a recording, whose rig may have the name of a live one, those of the replay.
    """

    def __init__(self, feed: Feed, sessions: LoginSessions, jobs: Callable[[str], Sequence[Job]]) -> None:
        self._feed, self._sessions, self._jobs = feed, sessions, jobs
        self._readers = 0

    async def board(self, socket: WebSocket) -> None:
        """Frames of one board, named in the path."""
        name = socket.path_params["board"]
        board: BoardFeed | None = None
        cursor, looked_s, journal_count = 0, -math.inf, -1
        sent: dict[str, str] = {}

        def frame(now_s: float) -> dict[str, Any]:
            nonlocal board, cursor, looked_s, journal_count
            known = self._feed.board(name)
            if known is not board:  # it is new, or was removed and is back
                board, cursor, looked_s, journal_count = known, 0, -math.inf, -1
                sent.clear()
            if board is None:
                return {"jobs": self._job_words(name)}
            traces, first = board.companion(Traces), cursor == 0
            traces.pump()
            rows, cursor = traces.since(cursor)
            made: dict[str, Any] = {"now": snapshot.now(board), "rows": rows}
            if first and rows:
                made["past"] = traces.past()
            if now_s - looked_s >= REST_S:
                looked_s = now_s
                rest = snapshot.rest(board) | {"travel_m": travel_m(board)}
                for part, content in (("rest", rest), ("jobs", self._job_words(name))):
                    text = json.dumps(content)
                    if text != sent.get(part):
                        sent[part], made[part] = text, content
                count, entries = board.journal()
                if count != journal_count:
                    journal_count, made["journal"] = count, snapshot.journal(entries)
            return made

        await self._serve(socket, frame, FRAME_S)

    async def spectrum(self, socket: WebSocket) -> None:
        """The spectra of one board, named in the path."""
        name = socket.path_params["board"]
        watch: Watch | None = None

        def frame(_: float) -> dict[str, Any]:
            nonlocal watch
            board = self._feed.board(name)
            if watch is not None and watch.board is not board:
                watch.close()
                watch = None
            if watch is None and board is not None:
                watch = Watch(board)
            return {} if watch is None else {"spectra": watch.spectra()}

        try:
            await self._serve(socket, frame, SPECTRUM_S)
        finally:
            if watch is not None:
                watch.close()

    async def overview(self, socket: WebSocket) -> None:
        """A line of each board."""
        known: set[str] = set()

        def frame(_: float) -> dict[str, Any]:
            boards = self._feed.board_feeds()
            made = {"boards": [snapshot.summary(board) for board in boards], "jobs": self._job_words("")}
            new = [board for board in boards if board.name not in known]
            if new:  # the page makes the rest of its lines from the frames
                made["sparks"] = {board.name: board.companion(Traces).spark() for board in new}
                known.update(board.name for board in new)
            return made

        await self._serve(socket, frame, OVERVIEW_S)

    def _job_words(self, board: str) -> dict[str, Any]:
        return {job.kind: snapshot.job(job) for job in self._jobs(board)}

    async def _serve(self, socket: WebSocket, frame: Callable[[float], dict[str, Any]], period_s: float) -> None:
        session: LoginSession = socket.scope["board51_session"]
        if self._readers >= MAX_READERS:
            await socket.close(1013)
            return

        def texts(now_s: float) -> list[str]:
            made = frame(now_s)
            made["at_s"] = round(now_s, 3)
            made["left_s"] = round(self._sessions.left_s(session, now_s))
            return [json.dumps(made, allow_nan=False)]

        await socket.accept(subprotocol=PROTOCOL)
        self._readers += 1
        try:
            await pour(socket, self._sessions, texts, period_s, acts=True)  # a page sends "acted"
        finally:
            self._readers -= 1


async def pour(
    socket: WebSocket,
    sessions: LoginSessions,
    texts: Callable[[float], Iterable[str]],
    period_s: float,
    *,
    acts: bool = False,
) -> None:
    """Send until the client leaves.

    Args:
        socket: that was accepted.
        sessions: tell whether its session is open.
        texts: Returns what has come since the last call; takes the present monotonic time.
        period_s: between two calls.
        acts: whether a message of the client is an action of its user; any is dropped.
    """
    session: LoginSession = socket.scope["board51_session"]

    async def listen() -> None:
        while (await socket.receive())["type"] != "websocket.disconnect":
            if acts:
                sessions.acted(session, time.monotonic())

    leaving = asyncio.create_task(listen())
    due_s = time.monotonic()
    try:
        while not leaving.done():
            now_s = time.monotonic()
            if not sessions.is_open(session, now_s):
                await asyncio.wait_for(socket.close(SESSION_OVER), STUCK_S)
                return
            for text in texts(now_s):
                await asyncio.wait_for(socket.send_text(text), STUCK_S)
            due_s = max(due_s + period_s, time.monotonic())  # a late frame does not make the next one late
            await asyncio.wait({leaving}, timeout=due_s - time.monotonic())
    except (WebSocketDisconnect, TimeoutError, RuntimeError):
        pass  # the client left or does not read: only its socket ends
    finally:
        leaving.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await leaving
