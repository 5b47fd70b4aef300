"""HTTP requests of the page's script and other programs; answers are JSON in the form of a CommandReply.

POST /api/<board>/stop              no body; of <board> "*": every board; {"boards": {"rig": answer}} then
POST /api/<board>/command           a Command as protobuf's JSON: {"set_reference": {"x_ref_m": 0.003}}
POST /api/<board>/acknowledge       {"name": "divergence-x"}, with "shelve_s" to shelve it; {"names": [..]} for several
POST /api/<board>/gains             a file; returns its command and table, sends nothing to the board
POST /api/<board>/job               {"kind": "campaign" | "diagnose" | ..., "act": "start" | "stop", ..}, see starts.py,
                                    {"kind": "replay", "act": "order", "order": "pause"}, see record/player.py
POST /api/*/delete                  {"log": "logs/NAME.mcap"}
GET  /api/summary/<name>            summary of a log
GET  /api/sessions?where=nis > 3    table of the sessions of the gateway's logs, see record/catalogue
GET  /api/timeline/<name>           start, duration and marks of a log, see record/timeline.py
GET  /api/<board>/plant?mass_g=8.28&...  what is wrong about the data of a plant, see model/plant.py; changes nothing
GET  /api/<board>/export/<name>?to=fmu   a model for another tool, see turns.py
GET  /log/<name>, /report-file/<name>    a file that the lists name

Rule: summaries and exports are one process at a time, which ends with its request (turns.py).  acts.py has the rules
of acts.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable

from google.protobuf.json_format import ParseDict, ParseError
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from gateway.views.alarms import MAX_ALARMS
from gateway.views.dispatch import EVERY_RIG, Wish
from gateway.views.hmi.actions import Actions, Order
from gateway.views.hmi.acts import Acts, status_of
from gateway.views.hmi.gains import command_of, parse_gains, rows
from gateway.views.hmi.library import LibraryFile, download
from gateway.views.hmi.model.plant import judged
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.starts import STARTS
from gateway.views.hmi.texts import text_of
from gateway.views.hmi.turns import FORMATS, Turns
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError

# A report was made from recordings: it may draw itself, and reach nothing.
_REPORT_POLICY = (
    "sandbox allow-same-origin; default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:;"
    " frame-ancestors 'self'"
)
MAX_CONDITION = 1000  # characters
_JOB_ACTS = ("start", "stop", "order")


class Requests:
    """The endpoints."""

    def __init__(self, actions: Actions, acts: Acts, work: ModelWork) -> None:
        self._actions, self._acts = actions, acts
        self._work = work
        self._turns = Turns()

    def routes(self) -> list[Route]:
        """Return the routes of the requests."""
        changes = {
            "/api/{board}/stop": self.stop,
            "/api/{board}/command": self.command,
            "/api/{board}/acknowledge": self.acknowledge,
            "/api/{board}/gains": self.gains,
            "/api/{board}/job": self.job,
            "/api/{board}/delete": self.delete,
            "/api/{board}/remove": self.remove,
            "/api/{board}/campaign": self.campaign,
        }
        reads = {
            "/log/{name:path}": self.log,
            "/report-file/{name:path}": self.report,
            "/api/summary/{name:path}": self.summary,
            "/api/sessions": self.sessions,
            "/api/timeline/{name:path}": self.timeline,
            "/api/{board}/export/{name:path}": self.export,
            "/api/{board}/plant": self.plant,
        }
        return [Route(path, endpoint, methods=["POST"]) for path, endpoint in changes.items()] + [
            Route(path, endpoint, methods=["GET"]) for path, endpoint in reads.items()
        ]

    async def stop(self, request: Request) -> Response:
        """Switch the coil off at once."""
        board = request.path_params["board"]
        replies = await self._acts.stop(request, board)
        if board != "*":
            return _answer(replies[board])
        boards = {name: _body(reply) for name, reply in replies.items()}
        return JSONResponse({"boards": boards}, status_code=200 if all(r.accepted for r in replies.values()) else 409)

    async def command(self, request: Request) -> Response:
        """Send any command of the bus."""
        table = await _json(request)
        if not set(table) <= set(_WHAT):
            raise _malformed(f"Give one of {', '.join(_WHAT)}.")
        command = _parsed(table)
        if command.WhichOneof("what") is None:
            text = f"The command has no action; give one of {', '.join(_WHAT)}."
            raise RefusalError("empty-command", text, status=400)
        board = request.path_params["board"]
        return await self._command(request, board, command)

    async def gains(self, request: Request) -> Response:
        """Return the command that a file of gains gives."""
        parameters = self._actions.feed.latest(request.path_params["board"], pb.Parameters)
        try:
            gains = await asyncio.to_thread(parse_gains, await request.body(), parameters)
        except DataError as error:
            raise RefusalError("bad-file", str(error)) from None
        law, table = "PID" if gains.law == pb.LAW_PID else "LQI", rows(gains, parameters)
        return JSONResponse({"accepted": True, "law": law, "rows": table, "command": command_of(gains)})

    async def job(self, request: Request) -> Response:
        """Start or stop a job."""
        table, board = await _json(request), request.path_params["board"]
        kind, act = str(table.get("kind")), table.get("act")
        if kind not in STARTS or act not in _JOB_ACTS:
            kinds = " | ".join(f'"{kind}"' for kind in STARTS)
            raise _malformed(f'Give {{"kind": {kinds}, "act": "start" | "stop"}}.')  # "order": of a replay

        def do(session: LoginSession, _wish: Wish) -> pb.CommandReply:
            if act == "order":
                return self._actions.order_replay(session, str(table.get("order")))
            if act == "stop":
                return self._actions.stop_job(session, kind, "*" if kind == "replay" else board)
            return STARTS[kind](self._work, Order(session=session, kind=kind, board=board, table=table))

        return await self._act(request, board if act == "start" and board != EVERY_RIG else "", do)

    async def delete(self, request: Request) -> Response:
        """Delete a log."""
        name = (await _json(request)).get("log")
        if not isinstance(name, str):
            raise _malformed('Give {"log": "..."}.')
        return await self._act(request, "", lambda session, _: self._actions.delete_log(session, name))

    async def campaign(self, request: Request) -> Response:
        """Rename or delete a campaign."""
        table, board = await _json(request), request.path_params["board"]
        name, title = str(table.get("name") or ""), str(table.get("title") or "")
        changes: dict[object, Callable[[LoginSession, Wish], pb.CommandReply]] = {
            "rename": lambda session, _: self._work.rename(session, board, name, title),
            "delete": lambda session, _: self._work.delete(session, board, name),
        }
        change = changes.get(table.get("act"))
        if change is None:
            raise _malformed('Give {"name": "...", "act": "rename" | "delete", "title": "..."}.')
        return await self._act(request, "", change)

    async def remove(self, request: Request) -> Response:
        """Take a rig off the pages that has not been seen for minutes."""
        board = request.path_params["board"]
        return await self._act(request, "", lambda session, _: self._actions.remove(session, board))

    async def acknowledge(self, request: Request) -> Response:
        """Acknowledge or shelve an alarm, or acknowledge several."""
        table, board = await _json(request), request.path_params["board"]
        name, names, shelve_s = table.get("name"), table.get("names"), table.get("shelve_s", 0.0)
        if isinstance(names, list) and 0 < len(names) <= MAX_ALARMS and all(isinstance(name, str) for name in names):
            several = [str(name) for name in names]

            def acknowledge(session: LoginSession, wish: Wish) -> pb.CommandReply:
                return self._actions.acknowledge_all(session, board, several, issued_ns=wish.issued_ns)

            return await self._act(request, board, acknowledge)
        if not isinstance(name, str) or not isinstance(shelve_s, int | float):
            raise _malformed('Give {"name": "...", "shelve_s": 600} or {"names": ["...", ...]}.')

        command = _parsed({"acknowledge": {"alarm": name, "shelve_s": shelve_s}})
        return await self._command(request, board, command)

    async def log(self, request: Request) -> Response:
        """Return one MCAP file."""
        return download(await self._log(request))

    async def report(self, request: Request) -> Response:
        """Return one report of a diagnosis."""
        entry = await asyncio.to_thread(self._actions.report, request.path_params["name"])
        headers = {"content-security-policy": _REPORT_POLICY, "x-frame-options": "SAMEORIGIN"}
        return FileResponse(entry.path, media_type="text/html", headers=headers)

    async def summary(self, request: Request) -> Response:
        """Return the summary of a log as text."""
        return _text_answer(await self._turns.summary(request, await self._log(request)))

    async def sessions(self, request: Request) -> Response:
        """Return the sessions in the gateway's logs that satisfy a condition, as text."""
        condition = request.query_params.get("where", "")[:MAX_CONDITION]
        return _text_answer(await self._turns.sessions(request, self._actions.logs.folders[0], condition))

    async def timeline(self, request: Request) -> Response:
        """Return start, duration and marks of a log."""
        text = await self._turns.timeline(request, await self._log(request))
        return Response(text, media_type="application/json")

    async def plant(self, request: Request) -> Response:
        """Return what is wrong or unusual about the data of a plant."""
        parameters = self._work.feed.latest(request.path_params["board"], pb.Parameters)
        return JSONResponse(judged(request.query_params, parameters))

    async def export(self, request: Request) -> Response:
        """Return a model as a file for another tool."""
        board, name, to = *request.path_params.values(), request.query_params.get("to", "")
        if to not in FORMATS:
            raise RefusalError("no-model", text_of("refusal.no_model"), status=404)
        model = await asyncio.to_thread(self._work.model, board, name)
        download = await self._turns.export(request, model, to)
        headers = {"content-disposition": f'attachment; filename="{download.name}"'}
        return Response(download.data, media_type="application/octet-stream", headers=headers)

    async def _log(self, request: Request) -> LibraryFile:
        return await asyncio.to_thread(self._actions.log, request.path_params["name"])

    async def _command(self, request: Request, board: str, what: pb.Command) -> Response:
        return await self._act(
            request, board, lambda session, wish: self._actions.command(session, board, what, issued_ns=wish.issued_ns)
        )

    async def _act(self, request: Request, board: str, do: Callable[[LoginSession, Wish], pb.CommandReply]) -> Response:
        return _answer(await self._acts.act(request, board, do))


_WHAT = [field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields]


def _body(reply: pb.CommandReply) -> dict[str, object]:
    return {name: getattr(reply, name) for name in ("accepted", "refused_by", "reason", "text", "tick")}


def _answer(reply: pb.CommandReply) -> JSONResponse:
    return JSONResponse(_body(reply), status_code=status_of(reply))


def _text_answer(text: str) -> JSONResponse:
    """Return the answer of a command that a request ran."""
    return JSONResponse({"accepted": True, "text": text})


def _parsed(table: dict[str, object]) -> pb.Command:
    try:
        return ParseDict(table, pb.Command())
    except (ParseError, TypeError, ValueError, OverflowError) as error:
        raise _malformed(f"The body is not a command: {str(error)[:200]}.") from None


def _malformed(text: str) -> RefusalError:
    return RefusalError("malformed", text, status=400)


async def _json(request: Request) -> dict[str, object]:
    """Return the keys of a body.

    Raises:
        RefusalError: it is not a JSON object.
    """
    try:
        table = json.loads(await request.body())
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict):
        raise _malformed("The body is not a JSON object.")
    return table
