"""The paths of the API, in one table: the server's routes, the description and its page are made of it.

Rule 1: an endpoint does what a request of the page does, by the same functions; here it gets its form for programs.
Rule 2: STOP acts whatever its body and query are, in threads of its own, and before all acts that wait.
"""

from __future__ import annotations

import asyncio

from starlette.responses import PlainTextResponse, Response

from gateway.views.dispatch import Wish
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts
from gateway.views.hmi.api import commands, rigs, shapes
from gateway.views.hmi.api.base import ACT, RIG, Base, answer, body_of_one
from gateway.views.hmi.api.queries import CaptureQuery, EventsQuery, StatesQuery, StreamQuery
from gateway.views.hmi.api.recent import Samples
from gateway.views.hmi.api.resource import BINARY, CSV, JSON, Call, Endpoint, ProblemError
from gateway.views.hmi.downloads import download
from gateway.views.hmi.per_board import PerBoard
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb

EVERY = "*"
_COMMAND = body_of_one("command", {name: kind for name, (kind, _) in commands.KINDS.items()})


class Endpoints(Base):
    """The endpoints about rigs and logs; those of work on models are in job_endpoints.py.

    Args:
        actions: checks rights, and acts.
        acts: runs acts.
        recent: the newest samples.
    """

    def __init__(self, actions: Actions, acts: Acts, recent: PerBoard[Samples]) -> None:
        super().__init__(actions, acts)
        self._recent = recent

    def table(self) -> list[Endpoint]:
        """Return these endpoints."""
        e, get, post = Endpoint, "GET", "POST"
        return [
            e(method=get, path="/rigs", run=self.rigs, answer=shapes.Rigs, tag="rigs"),
            e(method=get, path="/rigs/{rig}", run=self.rig, answer=shapes.Rig, tag="rigs", statuses=RIG),
            e(method=get, path="/rigs/{rig}/state", run=self.state, answer=shapes.State, tag="samples",
              statuses={**RIG, 503: "no sample has come"}),
            e(method=get, path="/rigs/{rig}/states", run=self.states, answer=shapes.States, tag="samples",
              query=StatesQuery, media=(JSON, CSV), statuses=RIG),
            e(method=get, path="/rigs/{rig}/stream", run=self.stream, answer=shapes.State, tag="samples",
              query=StreamQuery, statuses={426: "not a WebSocket"}),
            e(method=get, path="/rigs/{rig}/alarms", run=self.alarms, answer=shapes.Alarms, tag="events", statuses=RIG),
            e(method=get, path="/rigs/{rig}/events", run=self.events, answer=shapes.Events, tag="events",
              query=EventsQuery, statuses=RIG),
            e(method=get, path="/rigs/{rig}/events/stream", run=self.event_stream, answer=shapes.Notice, tag="events",
              statuses={426: "not a WebSocket"}),
            e(method=get, path="/rigs/{rig}/capture", run=self.capture, answer=shapes.CaptureSamples, tag="samples",
              query=CaptureQuery, media=(JSON, CSV), statuses={404: "no rig of this name; no such capture yet"}),
            e(method=post, path="/rigs/{rig}/commands", run=self.command, answer=shapes.Reply, tag="commands",
              body=_COMMAND, body_type=commands.Body, statuses=ACT),
            e(method=post, path="/rigs/{rig}/stop", run=self.stop, answer=shapes.Reply, tag="commands",
              statuses=ACT, unchecked=True),
            e(method=get, path="/logs", run=self.logs, answer=shapes.Logs, tag="logs"),
            e(method=get, path="/logs/{log}", run=self.log, answer=None, tag="logs", media=(BINARY,),
              statuses={404: "no log of this name"}),
        ]  # fmt: skip

    async def rigs(self, _: Call) -> shapes.Rigs:
        """List all rigs of the site."""
        feed = self._actions.feed
        return shapes.Rigs(site=feed.site, rigs=[rigs.entry(board) for board in feed.board_feeds()])

    async def rig(self, call: Call) -> shapes.Rig:
        """Return the status of a rig: mode, reference, alarms, divergence from the twin, model, limits."""
        return rigs.rig(self._board(call))

    async def state(self, call: Call) -> shapes.State:
        """Return the newest sample."""
        board = self._board(call)
        newest = board.latest(pb.State)
        if newest is None:
            raise ProblemError(503, "no-sample", f"No sample of {board.name} has come. {board.link().reason}".strip())
        return rigs.state(newest)

    async def states(self, call: Call) -> Response:
        """Return the samples of the last seconds, every one, as columns (JSON) or rows with a header (CSV)."""
        samples = self._recent.of(self._board(call)).last(call.query.last_s)
        if call.query.format == "json":
            return Response(await asyncio.to_thread(rigs.json_columns, samples), media_type=JSON)
        return PlainTextResponse(await asyncio.to_thread(rigs.csv_table, samples), media_type=CSV)

    async def stream(self, call: Call) -> Response:
        """Send samples over a WebSocket, one in each message: an object (JSON), or a line (CSV, first the header)."""
        raise ProblemError(426, "upgrade", "This is a WebSocket", remedy="Open it as ws:// or wss://, not with GET")

    async def event_stream(self, call: Call) -> Response:
        """Send the alarms, then each event and each change of an alarm, over a WebSocket: an object in each message."""
        return await self.stream(call)

    async def alarms(self, call: Call) -> shapes.Alarms:
        """List the alarms that are active, not acknowledged or shelved; the command acknowledge acknowledges one."""
        return shapes.Alarms(alarms=rigs.alarms(self._board(call)))

    async def events(self, call: Call) -> shapes.Events:
        """List the newest events, the oldest first."""
        events = self._board(call).events()[-call.query.last :]
        return shapes.Events(events=[rigs.event(event) for event in events])

    async def capture(self, call: Call) -> Response | shapes.CaptureSamples:
        """Return the newest capture, which the command capture has started: i_c around a step of u_c."""
        board, query = self._board(call), call.query
        record, newest = board.latest(pb.CaptureRecord), board.latest(pb.State)
        is_old = record is None or (newest is not None and record.session != newest.session)
        if record is None or record.tick < query.from_tick or (is_old and query.from_tick):
            raise ProblemError(404, "no-capture", f"No such capture of {board.name} has come")
        if query.format == "json":
            return rigs.capture(record)
        return PlainTextResponse(rigs.capture_csv(record), media_type=CSV)

    async def command(self, call: Call) -> Response:
        """Send a command to the board, and wait for its answer; the same set as `board51 send`."""
        board, body = call.path("rig"), call.body
        if isinstance(body, commands.Stop):
            return await self.stop(call)
        command = commands.KINDS[body.command][1](body)

        def do(session: LoginSession, wish: Wish) -> pb.CommandReply:
            if isinstance(body, commands.Acknowledge | commands.Shelve | commands.Unshelve):
                what = command.acknowledge
                return self._actions.acknowledge(
                    session, board, what.alarm, comment=what.comment, shelve_s=what.shelve_s, issued_ns=wish.issued_ns
                )
            return self._actions.command(session, board, command, issued_ns=wish.issued_ns)

        return await self._act(call, do)

    async def stop(self, call: Call) -> Response:
        """Switch the coil off at once; of the rig `*`: of all rigs.  It acts whatever is sent with it."""
        replies = await self._acts.stop(call.request, call.path("rig"))
        refused = {name: reply for name, reply in replies.items() if not reply.accepted}
        if call.path("rig") != EVERY:
            return answer(next(iter(replies.values())))
        reply = pb.CommandReply(accepted=True, text=f"STOP of {', '.join(replies) or 'no rig'}")
        if refused:
            reply.CopyFrom(next(iter(refused.values())))
            reply.text = " ".join(f"{name}: {answer.text}" for name, answer in refused.items())
        return answer(reply)

    async def logs(self, _: Call) -> shapes.Logs:
        """List the logs and recordings of all rigs."""
        entries = await asyncio.to_thread(self._actions.logs.entries)
        return shapes.Logs(
            logs=[shapes.LogEntry(name=entry.name, bytes=entry.bytes, changed_s=entry.changed_s) for entry in entries]
        )

    async def log(self, call: Call) -> Response:
        """Return an MCAP file."""
        entry = await asyncio.to_thread(self._actions.logs.find, call.path("log"))
        if entry is None:
            raise ProblemError(404, "no-log", text_of("refusal.no_log"))
        return download(entry)
