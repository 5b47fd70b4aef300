"""Runs the acts of requests: checked for their age, given up when their client leaves, apart from STOP.

The page's requests and the API share one object, so a STOP of either gives up the waiting acts of both.

Rule 1: a request may give the time at which it was made in PAGE_TIME_HEADER.  It counts by this server's clock, which
        the page knows from its frames.  A delayed request is refused, because its sender has already seen a time-out.
        A STOP always acts.
Rule 2: acts and STOP have threads of their own, and a STOP gives up the acts that wait for its rig (views/dispatch.py).
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable

from starlette.requests import Request

from gateway.views.dispatch import FRESH_S, Dispatch, Wish
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.guard import session_of
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from gateway.views.hmi.turns import departure
from protocol.bus import board51_pb2 as pb

PAGE_TIME_HEADER = "x-board51-seen"  # s, of this server's monotonic clock
_STATUS = {"not-allowed": 403, "session-over": 401, "no-board": 404, "not-delivered": 503}


class Acts:
    """The threads of one server."""

    def __init__(self, actions: Actions) -> None:
        self._actions = actions
        self._dispatch = Dispatch("hmi", actions.feed.stopped_s)

    async def stop(self, request: Request, board: str) -> dict[str, pb.CommandReply]:
        """Switch the coil off at once, of one board or ("*") of all; return their replies."""
        session = session_of(request)
        return await self._dispatch.stop([board], lambda: self._actions.stop(session, board))

    async def act(
        self, request: Request, board: str, do: Callable[[LoginSession, Wish], pb.CommandReply]
    ) -> pb.CommandReply:
        """Carry out a request whose body has been read; `board` is its rig, "" for none."""
        session, wish = session_of(request), Wish(board=board, arrived_s=_made_s(request))

        def leave(_: asyncio.Task[None]) -> None:
            wish.has_left = True

        leaving = asyncio.create_task(departure(request))
        leaving.add_done_callback(leave)
        try:
            if not abs(time.monotonic() - wish.arrived_s) <= FRESH_S:  # also NaN
                raise RefusalError("not-fresh", text_of("refusal.not_fresh"))
            return await self._dispatch.act(wish, lambda: do(session, wish))
        except RefusalError as refusal:
            return refusal.reply
        finally:
            leaving.cancel()


def status_of(reply: pb.CommandReply) -> int:
    """Return the HTTP status of a reply."""
    return 200 if reply.accepted else _STATUS.get(reply.reason, 409)


def _made_s(request: Request) -> float:
    """Return when a request was made, or at least arrived: monotonic; NaN where its date cannot be read."""
    arrived_s: float = request.scope["board51_arrived_s"]
    date = request.headers.get(PAGE_TIME_HEADER)
    try:
        made_s = arrived_s if date is None else float(date)
    except ValueError:
        return math.nan
    return min(arrived_s, made_s) if made_s - arrived_s <= FRESH_S else math.nan
