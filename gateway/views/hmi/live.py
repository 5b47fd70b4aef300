"""Sends frames to a browser, 30 per second, as long as it reads them.

Rule 1: the newest frame wins.  A frame is made when the last one has gone out, so a slow browser gets fewer frames and
        memory holds one.  Rows that it missed come with the next frame, as far as the ring of `traces.py` reaches.
Rule 2: a browser that takes nothing for STUCK_S is cut off.
Rule 3: a frame goes out only while the session is open.
Rule 4: a frame says when it was made, by this server's clock: with it a page dates what it sends, see requests.py.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.views.board_feed import BoardFeed
from gateway.views.feed import Feed
from gateway.views.hmi import snapshot
from gateway.views.hmi.guard import PROTOCOL, SESSION_OVER
from gateway.views.hmi.jobs import Job
from gateway.views.hmi.per_board import PerBoard
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


class Snapshots:
    """The traces of all boards of one feed, pumped once for any number of browsers.

    Args:
        feed: of one site.
    """

    def __init__(self, feed: Feed) -> None:
        self.feed = feed
        self.traces = PerBoard(feed, Traces)

    async def pump(self) -> None:
        """Follow every board; runs until it is cancelled."""
        await self.traces.follow(FRAME_S, Traces.pump)

    def rest(self, board: BoardFeed) -> dict[str, Any]:
        """See snapshot.rest; with what the drawing needs."""
        return snapshot.rest(board) | {"travel_m": self._travel_m(board)}

    def _travel_m(self, board: BoardFeed) -> float | None:
        plant = card_plant(board.latest(pb.PlantCard))
        if plant is not None:
            return plant.travel_m
        model, parameters = board.latest(pb.TwinModel), board.latest(pb.Parameters)
        travel_m = travel_of(model.model_json) if model is not None else math.nan
        if math.isfinite(travel_m):
            return travel_m
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
        snapshots: what to show.
        sessions: who may look.
        jobs: of a rig; on pages of a recording, whose rig may have the name of a live one, those of the replay.
    """

    def __init__(self, snapshots: Snapshots, sessions: LoginSessions, jobs: Callable[[str], Sequence[Job]]) -> None:
        self._snapshots, self._sessions, self._jobs = snapshots, sessions, jobs
        self._readers = 0

    async def board(self, socket: WebSocket) -> None:
        """Frames of one board, named in the path."""
        name = socket.path_params["board"]
        board: BoardFeed | None = None
        cursor, looked_s, journal_count = 0, -math.inf, -1
        sent: dict[str, str] = {}

        def frame(now_s: float) -> dict[str, Any]:
            nonlocal board, cursor, looked_s, journal_count
            known = self._snapshots.feed.board(name)
            if known is not board:  # it is new, or was removed and is back
                board, cursor, looked_s, journal_count = known, 0, -math.inf, -1
                sent.clear()
            if board is None:
                return {"jobs": self._job_words(name)}
            traces, first = self._snapshots.traces.of(board), cursor == 0
            rows, cursor = traces.since(cursor)
            made: dict[str, Any] = {"now": snapshot.now(board), "rows": rows}
            if first and rows:
                made["past"] = traces.past()
            if now_s - looked_s >= REST_S:
                looked_s = now_s
                for part, content in (("rest", self._snapshots.rest(board)), ("jobs", self._job_words(name))):
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
            board = self._snapshots.feed.board(name)
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
        feed = self._snapshots.feed
        known: set[str] = set()

        def frame(_: float) -> dict[str, Any]:
            boards = feed.board_feeds()
            made = {"boards": [snapshot.summary(board) for board in boards], "jobs": self._job_words("")}
            new = [board for board in boards if board.name not in known]
            if new:  # the page makes the rest of its lines from the frames
                made["sparks"] = {board.name: self._snapshots.traces.of(board).spark() for board in new}
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
        await socket.accept(subprotocol=PROTOCOL)
        self._readers += 1
        listener = asyncio.create_task(self._listen(socket, session))
        due_s = time.monotonic()
        try:
            while not listener.done():
                begun_s = time.monotonic()
                if not self._sessions.is_open(session, begun_s):
                    await asyncio.wait_for(socket.close(SESSION_OVER), STUCK_S)
                    return
                made = frame(begun_s)
                made["at_s"] = round(begun_s, 3)
                made["left_s"] = round(self._sessions.left_s(session, begun_s))
                await asyncio.wait_for(socket.send_text(json.dumps(made, allow_nan=False)), STUCK_S)
                due_s = max(due_s + period_s, time.monotonic())  # a late frame does not make the next one late
                await asyncio.sleep(due_s - time.monotonic())
        except (WebSocketDisconnect, TimeoutError, RuntimeError):
            pass  # the browser disconnected or does not read: only this reader ends
        finally:
            self._readers -= 1
            listener.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await listener

    async def _listen(self, socket: WebSocket, session: LoginSession) -> None:
        while True:
            await socket.receive_text()  # "acted", whatever it says
            self._sessions.acted(session, time.monotonic())
