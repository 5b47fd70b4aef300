"""What the page's own script and other programs may ask by HTTP; answers are JSON in the form of a CommandReply.

POST /api/<board>/stop              no body
POST /api/<board>/command           a Command as protobuf's JSON: {"set_reference": {"x_ref_m": 0.003}}
POST /api/<board>/acknowledge       {"name": "divergence-x"}
GET  /api/session                   who am I
GET  /log/<name>, /report/<name>    a file that the lists name
POST /login (form), POST /logout
"""

from __future__ import annotations

import asyncio
import html
import json
import time
from pathlib import Path
from urllib.parse import parse_qs

from google.protobuf.json_format import ParseDict, ParseError
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from gateway.access.logins import Logins, TooMany
from gateway.access.users import Users
from gateway.views.hmi.console import Console
from gateway.views.hmi.guard import Guard, cookie_name, refusal
from gateway.views.hmi.sessions import Session
from protocol.bus import board51_pb2 as pb

_LOGIN = Path(__file__).parent / "static" / "login.html"
_STATUS = {"not-allowed": 403, "session-over": 401, "no-board": 404, "not-delivered": 503}
# A report was made from recordings: it may draw itself, and reach nothing.
_REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:"


class Requests:
    """The endpoints.

    Args:
        console: does what is asked.
        users: who may log in; None: nobody needs to.
    """

    def __init__(self, console: Console, users: Users | None) -> None:
        self._console = console
        self._logins = Logins(users) if users is not None else None
        self.guard: Guard | None = None  # makes the cookies; set once it stands

    def routes(self) -> list[Route]:
        """What is served, before NiceGUI's pages."""
        changes = {
            "/login": self.login,
            "/logout": self.logout,
            "/api/{board}/stop": self.stop,
            "/api/{board}/command": self.command,
            "/api/{board}/acknowledge": self.acknowledge,
        }
        reads = {
            "/login": self.login_form,
            "/api/session": self.session,
            "/log/{name:path}": self.log,
            "/report/{name:path}": self.report,
        }
        return [Route(path, endpoint, methods=["POST"]) for path, endpoint in changes.items()] + [
            Route(path, endpoint, methods=["GET"]) for path, endpoint in reads.items()
        ]

    async def stop(self, request: Request) -> Response:
        """Coil off at once."""
        return await self._command(request, pb.Command(stop=pb.Stop()))

    async def command(self, request: Request) -> Response:
        """Any command of the bus."""
        table = await _json(request)
        if table is None:
            return refusal(400, "malformed", "The body is not a JSON object.")
        if not set(table) <= set(_WHAT):
            return refusal(400, "malformed", f"Give one of {', '.join(_WHAT)}.")
        try:
            command = ParseDict(table, pb.Command())
        except (ParseError, TypeError, ValueError) as error:
            return refusal(400, "malformed", f"The body is not a command: {str(error)[:200]}.")
        if command.WhichOneof("what") is None:
            return refusal(400, "empty-command", "The command says not what to do.")
        return await self._command(request, command)

    async def acknowledge(self, request: Request) -> Response:
        """An alarm was seen."""
        table = await _json(request)
        name = table.get("name") if table is not None else None
        if not isinstance(name, str):
            return refusal(400, "malformed", 'Give {"name": "..."}.')
        board = request.path_params["board"]
        return _answer(await asyncio.to_thread(self._console.acknowledge, _session(request), board, name))

    async def session(self, request: Request) -> Response:
        """Who asks, and for how long still."""
        session = _session(request)
        left_s = self._console.sessions.left_s(session, time.monotonic())
        return JSONResponse(
            {"name": session.name, "role": self._console.role(session).word, "left_s": round(left_s)},
            headers={"cache-control": "no-store"},
        )

    async def log(self, request: Request) -> Response:
        """One MCAP file."""
        entry = await asyncio.to_thread(self._console.logs.find, request.path_params["name"])
        if entry is None:
            return refusal(404, "no-log", "There is no such log.")
        return FileResponse(entry.path, media_type="application/octet-stream", filename=entry.path.name)

    async def report(self, request: Request) -> Response:
        """One page of a diagnosis."""
        entry = await asyncio.to_thread(self._console.reports.find, request.path_params["name"])
        if entry is None:
            return refusal(404, "no-report", "There is no such report.")
        return FileResponse(entry.path, media_type="text/html", headers={"content-security-policy": _REPORT_POLICY})

    async def login_form(self, request: Request) -> Response:
        """The form."""
        if self._logins is None:
            return RedirectResponse("/", status_code=303)
        return _form("Your session is over: log in again." if "over" in request.query_params else "")

    async def login(self, request: Request) -> Response:
        """Name and password in, a session out."""
        if self._logins is None or self.guard is None:
            return RedirectResponse("/", status_code=303)
        fields = parse_qs((await request.body())[:4096].decode("utf-8", errors="replace"))
        name, password = (fields.get(field, [""])[0] for field in ("name", "password"))
        host = request.client.host if request.client is not None else ""
        browser = self._console.sessions.held(request.cookies.get(cookie_name(_host(request)), ""), name)
        user = await self._logins.login(name, password, host, browser=browser)
        if isinstance(user, TooMany):
            return _form(f"Too many passwords from your address. Try again in {user.wait_s:.0f} s.", status=429)
        if user is None:
            return _form("The name or the password is wrong.", status=401)
        session = self._console.sessions.open(user.name, user.role, time.monotonic())
        return RedirectResponse(
            "/", status_code=303, headers={"set-cookie": self.guard.cookie(session, _host(request))}
        )

    async def logout(self, request: Request) -> Response:
        """End the session."""
        assert self.guard is not None
        self._console.sessions.close(_session(request))
        return JSONResponse({"accepted": True}, headers={"set-cookie": self.guard.cookie(None, _host(request))})

    async def _command(self, request: Request, command: pb.Command) -> Response:
        reply = await asyncio.to_thread(self._console.command, _session(request), request.path_params["board"], command)
        return _answer(reply)


_WHAT = [field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields]


def _session(request: Request) -> Session:
    session: Session = request.scope["board51_session"]  # the guard has seen to it
    return session


def _host(request: Request) -> str:
    return str(request.headers.get("host", ""))


def _answer(reply: pb.CommandReply) -> JSONResponse:
    body = {
        "accepted": reply.accepted,
        "refused_by": reply.refused_by,
        "reason": reply.reason,
        "text": reply.text,
        "tick": reply.tick,
    }
    return JSONResponse(body, status_code=200 if reply.accepted else _STATUS.get(reply.reason, 409))


async def _json(request: Request) -> dict[str, object] | None:
    try:
        table = json.loads(await request.body())
    except (ValueError, RecursionError):
        return None
    return table if isinstance(table, dict) else None


def _form(said: str, *, status: int = 200) -> HTMLResponse:
    text = _LOGIN.read_text(encoding="utf-8").replace("{said}", html.escape(said))
    return HTMLResponse(text, status_code=status, headers={"cache-control": "no-store"})
