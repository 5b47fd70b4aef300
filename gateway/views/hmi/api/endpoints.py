"""The paths of the API, in one table: the server's routes, the description and its page are made of it.

Rule 1: an endpoint does what a request of the page does, by the same functions; here it gets its form for programs.
Rule 2: STOP acts whatever its body and query are, in threads of its own, and before all acts that wait.
"""

from __future__ import annotations

import asyncio

from starlette.responses import PlainTextResponse, Response

from gateway.views.dispatch import EVERY_RIG
from gateway.views.hmi import snapshot
from gateway.views.hmi.api import commands, rigs, shapes
from gateway.views.hmi.api.base import ACT, RIG, Base, answer
from gateway.views.hmi.api.forms import CaptureQuery, EventsQuery, StatesQuery, StreamQuery
from gateway.views.hmi.api.recent import Samples
from gateway.views.hmi.api.resource import BINARY, CSV, JSON, BodyKinds, Call, Endpoint
from gateway.views.hmi.api.rigs import Table
from gateway.views.hmi.library import download
from gateway.views.hmi.refusals import RefusalError
from protocol.bus import board51_pb2 as pb

_COMMAND = BodyKinds("command", {name: kind for name, (kind, _) in commands.KINDS.items()})


class Endpoints(Base):
    """The endpoints about rigs and logs; those of work on models are in job_endpoints.py."""

    def table(self) -> list[Endpoint]:
        """Return these endpoints."""
        e, get, post = Endpoint, "GET", "POST"
        return [
            e(get, "/rigs", self.rigs, shapes.Rigs, "rigs"),
            e(get, "/rigs/{rig}", self.rig, shapes.Rig, "rigs", statuses=RIG),
            e(get, "/rigs/{rig}/state", self.state, shapes.State, "samples",
              statuses={**RIG, 503: "no sample has come"}),
            e(get, "/rigs/{rig}/states", self.states, shapes.States, "samples",
              query=StatesQuery, media=(JSON, CSV), statuses=RIG),
            e(get, "/rigs/{rig}/stream", self.stream, shapes.State, "samples",
              query=StreamQuery, statuses={426: "not a WebSocket"}),
            e(get, "/rigs/{rig}/alarms", self.alarms, shapes.Alarms, "events", statuses=RIG),
            e(get, "/rigs/{rig}/events", self.events, shapes.Events, "events", query=EventsQuery, statuses=RIG),
            e(get, "/rigs/{rig}/events/stream", self.event_stream, shapes.Notice, "events",
              statuses={426: "not a WebSocket"}),
            e(get, "/rigs/{rig}/capture", self.capture, shapes.CaptureSamples, "samples",
              query=CaptureQuery, media=(JSON, CSV), statuses={404: "no rig of this name; no such capture yet"}),
            e(post, "/rigs/{rig}/commands", self.command, shapes.Reply, "commands", body=_COMMAND, statuses=ACT),
            e(post, "/rigs/{rig}/stop", self.stop, shapes.Reply, "commands", statuses=ACT, unchecked=True),
            e(get, "/logs", self.logs, shapes.Logs, "logs"),
            e(get, "/logs/{log}", self.log, None, "logs", media=(BINARY,), statuses={404: "no log of this name"}),
        ]  # fmt: skip

    async def rigs(self, _: Call) -> Table:
        """List all rigs of the site."""
        feed = self._actions.feed
        return {"site": feed.site, "rigs": [rigs.entry(board) for board in feed.board_feeds()]}

    async def rig(self, call: Call) -> Table:
        """Return the status of a rig: mode, reference, alarms, divergence from the twin, model, limits."""
        return rigs.rig(self._board(call))

    async def state(self, call: Call) -> Table:
        """Return the newest sample."""
        board = self._board(call)
        newest = board.latest(pb.State)
        if newest is None:
            raise RefusalError(
                "no-sample", f"No sample of {board.name} has come. {board.link().reason}".strip(), status=503
            )
        return rigs.state(newest)

    async def states(self, call: Call) -> Response:
        """Return the samples of the last seconds, every one, as columns (JSON) or rows with a header (CSV)."""
        samples = self._board(call).companion(Samples).last(call.query.last_s)
        if call.query.format == "json":
            return Response(await asyncio.to_thread(rigs.json_columns, samples), media_type=JSON)
        return PlainTextResponse(await asyncio.to_thread(rigs.csv_table, samples), media_type=CSV)

    async def stream(self, call: Call) -> Response:
        """Send samples over a WebSocket, one in each message: an object (JSON), or a line (CSV, first the header)."""
        raise RefusalError(
            "upgrade", "This is a WebSocket", status=426, remedy="Open it as ws:// or wss://, not with GET"
        )

    async def event_stream(self, call: Call) -> Response:
        """Send the alarms, then each event and each change of an alarm, over a WebSocket: an object in each message."""
        return await self.stream(call)

    async def alarms(self, call: Call) -> Table:
        """List the alarms that are active, not acknowledged or shelved; the command acknowledge acknowledges one."""
        return {"alarms": rigs.alarms(self._board(call))}

    async def events(self, call: Call) -> Table:
        """List the newest events, the oldest first."""
        events = self._board(call).events()[-call.query.last :]
        return {"events": [rigs.event(event) for event in events]}

    async def capture(self, call: Call) -> Response | Table:
        """Return the newest capture, which the command capture has started: i_c around a step of u_c."""
        board, query = self._board(call), call.query
        record, newest = board.latest(pb.CaptureRecord), board.latest(pb.State)
        is_old = record is None or (newest is not None and record.session != newest.session)
        if record is None or record.tick < query.from_tick or (is_old and query.from_tick):
            raise RefusalError("no-capture", f"No such capture of {board.name} has come", status=404)
        if query.format == "json":
            return rigs.capture(record)
        return PlainTextResponse(rigs.capture_csv(record), media_type=CSV)

    async def command(self, call: Call) -> Response:
        """Send a command to the board, and wait for its answer; the same set as `board51 send`."""
        board, body = call.path("rig"), call.body
        if isinstance(body, commands.Stop):
            return await self.stop(call)
        command = commands.command_of(body)
        return await self._act(
            call, lambda session, wish: self._actions.command(session, board, command, issued_ns=wish.issued_ns)
        )

    async def stop(self, call: Call) -> Response:
        """Switch the coil off at once; of the rig `*`: of all rigs.  It acts whatever is sent with it."""
        replies = await self._acts.stop(call.request, call.path("rig"))
        refused = {name: reply for name, reply in replies.items() if not reply.accepted}
        if call.path("rig") != EVERY_RIG:
            return answer(next(iter(replies.values())))
        reply = pb.CommandReply(accepted=True, text=f"STOP of {', '.join(replies) or 'no rig'}")
        if refused:
            reply.CopyFrom(next(iter(refused.values())))
            reply.text = " ".join(f"{name}: {answer.text}" for name, answer in refused.items())
        return answer(reply)

    async def logs(self, _: Call) -> Table:
        """List the logs and recordings of all rigs."""
        entries = await asyncio.to_thread(self._actions.logs.entries)
        return {"logs": [snapshot.fields(entry, "name", "bytes", "changed_s") for entry in entries]}

    async def log(self, call: Call) -> Response:
        """Return an MCAP file."""
        return download(await asyncio.to_thread(self._actions.log, call.path("log")))
