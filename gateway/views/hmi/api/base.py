"""The base of all endpoints: finds a rig, and acts on it by the functions of the page's requests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pydantic import TypeAdapter
from starlette.responses import Response

from gateway.views.board_feed import BoardFeed
from gateway.views.dispatch import Wish
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts, status_of
from gateway.views.hmi.api import rigs, shapes
from gateway.views.hmi.api.resource import JSON, Call, ProblemError, checked_body
from gateway.views.hmi.sessions import LoginSession
from protocol.bus import board51_pb2 as pb

RIG = {404: "no rig of this name"}
ACT = {
    403: "the role does not suffice", 404: "no rig of this name", 409: "refused; the code says why",
    503: "no gateway answers",
}  # fmt: skip
_REPLY = TypeAdapter(shapes.Reply)
Body = Callable[[Mapping[str, object], bool], Any]


class Base:
    """Endpoints of one server.

    Args:
        actions: checks rights, and acts.
        acts: runs acts.
    """

    def __init__(self, actions: Actions, acts: Acts) -> None:
        self._actions, self._acts = actions, acts

    def _board(self, call: Call) -> BoardFeed:
        name, feed = call.path("rig"), self._actions.feed
        board = feed.board(name)
        if board is None:
            known = ", ".join(feed.boards()) or "none yet: is the gateway running?"
            raise ProblemError(
                404, "no-board", f"No rig is called {name[:64]!r}", remedy=f"Take one of the rigs: {known}"
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


def body_of(kind: type) -> Body:
    """Return what makes a body of one type."""
    return lambda table, is_form: checked_body(kind, table, is_form)


def body_of_one(key: str, kinds: Mapping[str, type]) -> Body:
    """Return what makes a body of the type that its `key` names."""

    def made(table: Mapping[str, object], is_form: bool) -> Any:
        word = table.get(key)
        kind = kinds.get(str(word))
        if kind is None:
            what = f"{key} is missing" if word is None else f"{key} is {str(word)[:40]!r}"
            raise ProblemError(400, "malformed", what, remedy=f"Give one of {', '.join(kinds)}")
        return checked_body(kind, table, is_form)

    return made
