"""ASGI middleware that checks every HTTP and WebSocket request before the pages.

Rule 1: no session, no page: a browser is sent to /login, anything else gets 401, at / a line that
        says where to go.  Only PUBLIC is served without.
Rule 2: what changes something (any method but GET and HEAD) and every WebSocket must come from our own origin; without
        an Origin header it is not from a browser's page and is refused as well.
Rule 3: what changes something bears the session's token in TOKEN_HEADER, a WebSocket bears it as subprotocol.  The
        login form has no session yet: its origin is checked.
Rule 4: on loopback the Host must be a name of loopback, against foreign pages whose name resolves to 127.0.0.1.
Rule 5: a WebSocket ends with its session, also in the middle.
Rule 6: bodies are bounded.
Rule 7: a program has a session at the paths of `is_api` by its token, or, where no login is needed, without one
        (programs.py).  What a browser sends from a page of another server is refused there as well, by its Origin and
        Sec-Fetch-Site.  With a browser's cookie the rules above hold: no foreign page opens the API by it.
Rule 8: over TLS the browser is asked to use TLS for a year (HSTS).  It keeps that for the host's name, whatever the
        port, and not for an address.
"""

from __future__ import annotations

import hmac
import time
from collections.abc import Callable
from urllib.parse import quote, urlsplit

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gateway.views.hmi.problems import problem
from gateway.views.hmi.programs import Programs, is_api
from gateway.views.hmi.refusals import refusal
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from gateway.views.hmi.texts import text_of

COOKIE = "board51_session"  # with the port: see `cookie_name`
TOKEN_HEADER = "x-board51-token"
PROTOCOL = "board51"  # of our own WebSockets; the token follows it
MAX_BODY = 1_000_000  # bytes
PUBLIC = ("/login", "/static/")
LOOPBACK = ("localhost", "127.0.0.1", "::1")
SESSION_OVER = 4401  # WebSocket close code: log in again

_HEADERS = (
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),
    (b"content-security-policy", b"default-src 'self'; frame-ancestors 'none'; form-action 'self'; base-uri 'none'"),
    (b"cache-control", b"no-cache"),  # a page and its scripts are of one version
    # A connection that a browser keeps for its next request may have died in silence: STOP would go into it.
    (b"connection", b"close"),
)
_HTTPS_HEADERS = ((b"strict-transport-security", b"max-age=31536000"),)


class Guard:
    """ASGI middleware; the session of a request is `scope["board51_session"]`.

    Args:
        app: what is guarded.
        sessions: all that are open.
        programs: sessions of programs other than browsers.
        newcomer: Opens a session for a browser without one if no login is needed; else None.
        loopback: whether the server listens on loopback only.
        https: whether it speaks TLS.
    """

    def __init__(
        self,
        app: ASGIApp,
        sessions: LoginSessions,
        programs: Programs,
        *,
        newcomer: Callable[[], LoginSession] | None,
        loopback: bool,
        https: bool,
    ) -> None:
        self._app, self._sessions, self._programs, self._newcomer = app, sessions, programs, newcomer
        self._loopback, self._https = loopback, https
        self._added = _HEADERS + (_HTTPS_HEADERS if https else ())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request or one WebSocket, and pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        scope["board51_arrived_s"] = time.monotonic()  # before the body, which a network may hold up
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        cookies = HTTPConnection(scope).cookies
        session = self._sessions.get(cookies.get(cookie_name(headers.get("host", "")), ""), time.monotonic())
        if is_api(scope["path"]) and (session is None or "authorization" in headers):
            session = None if self._is_foreign(headers) else self._programs.session(headers, time.monotonic())
        if scope["type"] == "websocket":
            await self._websocket(scope, receive, send, headers, session)
        else:
            await self._http(scope, receive, send, headers, session)

    async def _http(
        self, scope: Scope, receive: Receive, send: Send, headers: dict[str, str], session: LoginSession | None
    ) -> None:
        path, reads = scope["path"], scope["method"] in ("GET", "HEAD")
        public = path.startswith(PUBLIC)
        of_api, of_program = is_api(path), session is not None and session.grant is not None
        refused = _refusal_of_program if of_api else refusal
        answer: Response | None = None
        opened = None
        if not self._host_is_known(headers):
            answer = refused(421, "host", text_of("refusal.host"))
        elif of_api and self._is_foreign(headers):
            answer = refused(403, "origin", text_of("refusal.origin"))
        elif of_api and session is None:
            answer = refused(401, "session", text_of("refusal.no_token"))
        elif not reads and not of_program and not self._same_origin(headers):
            answer = refused(403, "origin", text_of("refusal.origin"))
        elif session is None and not public:
            a_page = reads and "text/html" in headers.get("accept", "")
            if self._newcomer is not None and a_page:
                session = opened = self._newcomer()
            elif a_page:
                over = cookie_name(headers.get("host", "")) in headers.get("cookie", "")
                answer = RedirectResponse(login_for(path, over=over), status_code=303)
            elif reads and path == "/":  # somebody tries curl
                answer = PlainTextResponse(text_of("root.for_programs") + "\n")
            else:
                answer = refused(401, "session", text_of("refusal.session"))
        elif (
            not public
            and not of_program
            and (TOKEN_HEADER in headers or not reads)
            and not _bears_token(headers.get(TOKEN_HEADER, ""), session)
        ):  # a page of an earlier session also sends a token: it must reload
            status = 401 if reads else 403
            answer = refused(status, "token", text_of("refusal.token", header=TOKEN_HEADER))
        if answer is None and _too_long(headers):
            answer = refused(413, "oversize", text_of("refusal.oversize", bytes=MAX_BODY))
        send = self._with_headers(send, opened, headers.get("host", ""))
        if answer is not None:
            await answer(scope, receive, send)
            return
        scope["board51_session"] = session
        try:
            await self._app(scope, _bounded(receive), send)
        except ClientDisconnect:  # it went away in the middle of its body, or that was too long
            await refused(413, "oversize", text_of("refusal.oversize", bytes=MAX_BODY))(scope, receive, send)

    async def _websocket(
        self, scope: Scope, receive: Receive, send: Send, headers: dict[str, str], session: LoginSession | None
    ) -> None:
        good = session is not None and self._host_is_known(headers)
        if session is not None and good and session.grant is None:
            good = self._same_origin(headers)
            offered = scope.get("subprotocols", [])
            good = good and len(offered) == 2 and offered[0] == PROTOCOL and _bears_token(offered[1], session)
        if not good or session is None:
            await receive()  # websocket.connect
            await send({"type": "websocket.close", "code": SESSION_OVER})  # before accept: HTTP 403
            return
        holder = session
        scope["board51_session"] = holder

        async def watched() -> Message:
            message = await receive()
            if message["type"] == "websocket.receive" and not self._sessions.is_open(holder, time.monotonic()):
                await send({"type": "websocket.close", "code": SESSION_OVER})
                return {"type": "websocket.disconnect", "code": SESSION_OVER}
            return message

        await self._app(scope, watched, send)

    def _host_is_known(self, headers: dict[str, str]) -> bool:
        if not self._loopback:
            return True
        return (urlsplit(f"//{headers.get('host', '')}").hostname or "") in LOOPBACK

    def _same_origin(self, headers: dict[str, str]) -> bool:
        scheme = "https" if self._https else "http"
        return headers.get("origin", "") == f"{scheme}://{headers.get('host', '')}"

    def _is_foreign(self, headers: dict[str, str]) -> bool:
        """Return whether a browser sends this for a page of another server, as far as it says so."""
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return True
        return "origin" in headers and not self._same_origin(headers)

    def _with_headers(self, send: Send, opened: LoginSession | None, host: str) -> Send:
        async def sender(message: Message) -> None:
            if message["type"] == "http.response.start":
                present = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(h for h in self._added if h[0] not in present)]
                if opened is not None:
                    cookie = session_cookie(opened, host, lifetime_s=self._sessions.lifetime_s, https=self._https)
                    message["headers"].append((b"set-cookie", cookie.encode("latin-1")))
            await send(message)

        return sender


def session_of(request: Request) -> LoginSession:
    """Return the session of a request that the guard has let pass."""
    session: LoginSession = request.scope["board51_session"]
    return session


def login_for(path: str, *, over: bool) -> str:
    """Return the address of the login form that leads back to a page."""
    words = ["over"] * over + [f"next={quote(path, safe='/')}"] * (path != "/")
    return "/login" + ("?" + "&".join(words) if words else "")


def local_page(target: str) -> str:
    """Return `target` if it is a path on this server, else "/".

    A browser takes two slashes, one of them turned or not, for another server, and drops control characters before it
    looks.
    """
    is_local = target.startswith("/") and not target.startswith(("//", "/login"))
    return target if is_local and target.isprintable() and "\\" not in target else "/"


def _refusal_of_program(status: int, code: str, text: str) -> Response:
    answer = problem(status, code, text)
    if status == 401:
        answer.headers["www-authenticate"] = "Bearer"
    return answer


def session_cookie(session: LoginSession | None, host: str, *, lifetime_s: float, https: bool) -> str:
    """Return the Set-Cookie header of a session for a browser that requested `host`; with None it ends."""
    value, age_s = (session.token, round(lifetime_s)) if session is not None else ("", 0)
    secure = "; Secure" if https else ""
    return f"{cookie_name(host)}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age={age_s}{secure}"


def cookie_name(host: str) -> str:
    """Return the name of the cookie for a Host header, by the port in the browser's address bar.

    Cookies do not tell ports apart: with one name, two control rooms on one host, or behind two ssh tunnels, would log
    each other out.  Our own port would not do: behind two tunnels to two machines it may be the same.
    """
    port = host.rpartition(":")[2]
    return f"{COOKIE}_{port}" if port.isascii() and port.isdigit() else COOKIE


def _bears_token(supplied: str, session: LoginSession | None) -> bool:
    return session is not None and hmac.compare_digest(supplied.encode(), session.csrf.encode())


def _too_long(headers: dict[str, str]) -> bool:
    length = headers.get("content-length", "0")
    return not length.isdigit() or int(length) > MAX_BODY


def _bounded(receive: Receive) -> Receive:
    """Bound a body without Content-Length, too: more than MAX_BODY bytes end the request."""
    got = 0

    async def bounded() -> Message:
        nonlocal got
        message = await receive()
        got += len(message.get("body", b""))
        return message if got <= MAX_BODY else {"type": "http.disconnect"}

    return bounded
