"""The base of all endpoints: finds a rig, and acts on it by the functions of the page's requests."""

from __future__ import annotations

from collections.abc import Callable

from pydantic import TypeAdapter
from starlette.responses import Response

from gateway.views.board_feed import BoardFeed
from gateway.views.dispatch import Wish
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts, status_of
from gateway.views.hmi.api import rigs, shapes
from gateway.views.hmi.api.resource import JSON, Call
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession
from protocol.bus import board51_pb2 as pb

RIG = {404: "no rig of this name"}
ACT = RIG | {403: "the role does not suffice", 409: "refused; the code says why", 503: "no gateway answers"}
_REPLY = TypeAdapter(shapes.Reply)


class Base:
    """Endpoints of one server."""

    def __init__(self, actions: Actions, acts: Acts) -> None:
        self._actions, self._acts = actions, acts

    def _board(self, call: Call) -> BoardFeed:
        name, feed = call.path("rig"), self._actions.feed
        board = feed.board(name)
        if board is None:
            known = ", ".join(feed.boards()) or "none yet: is the gateway running?"
            raise RefusalError(
                "no-board", f"No rig is called {name[:64]!r}", status=404, remedy=f"Take one of the rigs: {known}"
            )
        return board

    async def _act(
        self, call: Call, do: Callable[[LoginSession, Wish], pb.CommandReply], *, board: str | None = None
    ) -> Response:
        self._board(call)
        return answer(await self._acts.act(call.request, call.path("rig") if board is None else board, do))


def answer(reply: pb.CommandReply) -> Response:
    """Return the response that tells the outcome of an act."""
    return Response(_REPLY.dump_json(rigs.reply(reply)), status_of(reply), media_type=JSON)
