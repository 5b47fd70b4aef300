"""The paths of the API, in one table: the server's routes, the description and its page are made of it.

Rule 1: an endpoint does what a request of the page does, by the same functions; here it gets its form for programs.
Rule 2: STOP acts whatever its body and query are, in threads of its own, and before all acts that wait.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import TypeAdapter
from starlette.responses import FileResponse, PlainTextResponse, Response

from gateway.views.dispatch import Wish
from gateway.views.feed import BoardFeed
from gateway.views.hmi import snapshot
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts, status_of
from gateway.views.hmi.api import commands, rigs, shapes
from gateway.views.hmi.api.queries import Identify, StartCampaign, StartRecording, StatesQuery, StreamQuery
from gateway.views.hmi.api.recent import Recent
from gateway.views.hmi.api.resource import (
    BINARY,
    CSV,
    JSON,
    Call,
    Endpoint,
    ProblemError,
    checked_body,
)
from gateway.views.hmi.downloads import download
from gateway.views.hmi.jobs import Job
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.starts import Start, starts
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb

EVERY = "*"
_REPLY = TypeAdapter(shapes.Reply)
_RIG = {404: "no rig of this name"}
_ACT = {
    403: "the role does not suffice", 404: "no rig of this name", 409: "refused; the code says why",
    503: "no gateway answers",
}  # fmt: skip


def _body_of_command(table: Mapping[str, object], is_form: bool) -> object:
    kind = commands.KINDS.get(str(table.get("command")))
    if kind is None:
        word = table.get("command")
        what = "command is missing" if word is None else f"command is {str(word)[:40]!r}"
        raise ProblemError(400, "malformed", what, remedy=f"Give one of {', '.join(commands.KINDS)}")
    return checked_body(kind[0], table, is_form)


def _body(kind: type) -> Callable[[Mapping[str, object], bool], Any]:
    return lambda table, is_form: checked_body(kind, table, is_form)


class Endpoints:
    """The endpoints of one server.

    Args:
        actions: checks rights, and acts.
        acts: runs acts.
        work: on models.
        recent: the newest samples.
    """

    def __init__(self, actions: Actions, acts: Acts, work: ModelWork, recent: Recent) -> None:
        self._actions, self._acts, self._work, self._recent = actions, acts, work, recent
        self._starts: dict[str, Start] = starts(actions, work)

    def table(self) -> list[Endpoint]:
        """Return all endpoints."""
        e, get, post = Endpoint, "GET", "POST"
        return [
            e(method=get, path="/rigs", run=self.rigs, answer=shapes.Rigs, tag="rigs"),
            e(method=get, path="/rigs/{rig}", run=self.rig, answer=shapes.Rig, tag="rigs", statuses=_RIG),
            e(method=get, path="/rigs/{rig}/state", run=self.state, answer=shapes.State, tag="samples",
              statuses={**_RIG, 503: "no sample has come"}),
            e(method=get, path="/rigs/{rig}/states", run=self.states, answer=shapes.States, tag="samples",
              query=StatesQuery, media=(JSON, CSV), statuses=_RIG),
            e(method=get, path="/rigs/{rig}/stream", run=self.stream, answer=shapes.State, tag="samples",
              query=StreamQuery, statuses={426: "not a WebSocket"}),
            e(method=post, path="/rigs/{rig}/commands", run=self.command, answer=shapes.Reply, tag="commands",
              body=_body_of_command, body_type=commands.Body, statuses=_ACT),
            e(method=post, path="/rigs/{rig}/stop", run=self.stop, answer=shapes.Reply, tag="commands",
              statuses=_ACT, unchecked=True),
            e(method=get, path="/rigs/{rig}/campaigns", run=self.campaigns, answer=shapes.Campaigns, tag="campaigns",
              statuses=_RIG),
            e(method=post, path="/rigs/{rig}/campaigns", run=self.start_campaign, answer=shapes.Reply,
              tag="campaigns", body=_body(StartCampaign), body_type=StartCampaign, statuses=_ACT),
            e(method=post, path="/rigs/{rig}/campaigns/interrupt", run=self.interrupt, answer=shapes.Reply,
              tag="campaigns", statuses=_ACT),
            e(method=get, path="/rigs/{rig}/models", run=self.models, answer=shapes.Models, tag="models",
              statuses=_RIG),
            e(method=post, path="/rigs/{rig}/models", run=self.identify, answer=shapes.Reply, tag="models",
              body=_body(Identify), body_type=Identify, statuses=_ACT),
            e(method=get, path="/rigs/{rig}/models/{model}", run=self.model, answer=dict[str, Any], tag="models",
              statuses={404: "no rig or model of this name"}),
            e(method=post, path="/rigs/{rig}/recordings", run=self.start_recording, answer=shapes.Reply, tag="logs",
              body=_body(StartRecording), body_type=StartRecording, statuses=_ACT),
            e(method=post, path="/rigs/{rig}/recordings/stop", run=self.stop_recording, answer=shapes.Reply,
              tag="logs", statuses=_ACT),
            e(method=get, path="/logs", run=self.logs, answer=shapes.Logs, tag="logs"),
            e(method=get, path="/logs/{log}", run=self.log, answer=None, tag="logs", media=(BINARY,),
              statuses={404: "no log of this name"}),
        ]  # fmt: skip

    async def rigs(self, _: Call) -> shapes.Rigs:
        """List all rigs of the site."""
        feed = self._actions.feed
        boards = [board for board in map(feed.board, feed.boards()) if board is not None]
        return shapes.Rigs(site=feed.site, rigs=[rigs.entry(board) for board in boards])

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

    async def command(self, call: Call) -> Response:
        """Send a command to the board, and wait for its answer; the same set as `board51 send`."""
        board, body = call.path("rig"), call.body
        if isinstance(body, commands.Stop):
            return await self.stop(call)
        command = commands.KINDS[body.command][1](body)

        def do(session: LoginSession, wish: Wish) -> pb.CommandReply:
            if isinstance(body, commands.Acknowledge):
                return self._actions.acknowledge(
                    session, board, body.alarm, comment=body.comment, issued_ns=wish.issued_ns
                )
            return self._actions.command(session, board, command, issued_ns=wish.issued_ns)

        return await self._act(call, do)

    async def stop(self, call: Call) -> Response:
        """Switch the coil off at once; of the rig `*`: of all rigs.  It acts whatever is sent with it."""
        replies = await self._acts.stop(call.request, call.path("rig"))
        refused = {name: reply for name, reply in replies.items() if not reply.accepted}
        if call.path("rig") != EVERY:
            return _answer(next(iter(replies.values())))
        reply = pb.CommandReply(accepted=True, text=f"STOP of {', '.join(replies) or 'no rig'}")
        if refused:
            reply.CopyFrom(next(iter(refused.values())))
            reply.text = " ".join(f"{name}: {answer.text}" for name, answer in refused.items())
        return _answer(reply)

    async def campaigns(self, call: Call) -> shapes.Campaigns:
        """List the campaigns of a rig, and the progress of the one that runs."""
        board = self._board(call).name
        folders = await asyncio.to_thread(self._work.campaigns, board)
        return shapes.Campaigns(
            work=self._progress("campaign", board),
            campaigns=[
                shapes.Campaign(
                    name=folder.name,
                    recordings=folder.recordings,
                    interrupted=folder.interrupted,
                    left=list(folder.left),
                    has_model=folder.model is not None,
                    has_diagnosis=folder.diagnosis is not None,
                )
                for folder in folders
            ],
        )

    async def start_campaign(self, call: Call) -> Response:
        """Start a campaign, which moves the ball; GET tells its progress."""
        body: StartCampaign = call.body
        table: dict[str, object] = {"quick": body.quick, "investigate": body.investigate}
        if body.resume:
            table = {"resume": True, "campaign": body.resume}
        return await self._start(call, "campaign", table)

    async def interrupt(self, call: Call) -> Response:
        """Interrupt the campaign that runs; it parks the ball."""
        return await self._end(call, "campaign")

    async def models(self, call: Call) -> shapes.Models:
        """List the models of a rig, and the progress of an identification that runs."""
        board = self._board(call).name
        files = await asyncio.to_thread(self._work.models, board)
        entries = [
            shapes.ModelEntry(name=f.name, kind=f.kind, made=f.made, summary=f.summary, in_use=f.in_use) for f in files
        ]
        return shapes.Models(work=self._progress("identify", board), models=entries)

    async def identify(self, call: Call) -> Response:
        """Identify K_A, T_A, K_c and b from a campaign; GET tells the progress and lists the model."""
        return await self._start(call, "identify", {"campaign": call.body.campaign})

    async def model(self, call: Call) -> Response:
        """Return a model file, as `board51 identify` writes it."""
        board = self._board(call).name
        files = await asyncio.to_thread(self._work.models, board)
        for file in files:
            if file.name == call.path("model"):
                return FileResponse(file.path, media_type=JSON, filename=f"{board}-{file.path.name}")
        raise ProblemError(404, "no-model", text_of("refusal.no_model"))

    async def start_recording(self, call: Call) -> Response:
        """Start a recording: a file of its own, which appears among the logs."""
        return await self._start(call, "record", {"title": call.body.title})

    async def stop_recording(self, call: Call) -> Response:
        """Stop the recording that runs, and close its file."""
        return await self._end(call, "record")

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

    def _board(self, call: Call) -> BoardFeed:
        name, feed = call.path("rig"), self._actions.feed
        board = feed.board(name)
        if board is None:
            known = ", ".join(feed.boards()) or "none yet: is the gateway running?"
            raise ProblemError(
                404, "no-board", f"No rig is called {name[:64]!r}", remedy=f"Take one of the rigs: {known}"
            )
        return board

    def _progress(self, kind: str, board: str) -> shapes.Work | None:
        job: Job | None = self._actions.jobs.get(kind, board)
        if job is None:
            return None
        return shapes.Work(**snapshot.job(job))

    async def _start(self, call: Call, kind: str, table: dict[str, object]) -> Response:
        board = self._board(call).name
        return await self._act(call, lambda session, _: self._starts[kind](session, board, table))

    async def _end(self, call: Call, kind: str) -> Response:
        board = self._board(call).name
        return await self._act(call, lambda session, _: self._actions.stop_job(session, kind, board), board="")

    async def _act(
        self, call: Call, do: Callable[[LoginSession, Wish], pb.CommandReply], *, board: str | None = None
    ) -> Response:
        self._board(call)
        return _answer(await self._acts.act(call.request, call.path("rig") if board is None else board, do))


def _answer(reply: pb.CommandReply) -> Response:
    return Response(_REPLY.dump_json(rigs.reply(reply)), status_of(reply), media_type=JSON)
