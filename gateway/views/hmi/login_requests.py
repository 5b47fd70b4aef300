"""HTTP requests about the session of a browser: the login form, login, logout, the current user.

POST /login (form), POST /logout
GET  /login                         the form
GET  /api/session                   the current user
"""

from __future__ import annotations

import time
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from gateway.access.logins import Logins, TooMany
from gateway.views.hmi.guard import cookie_name, local_page, session_cookie, session_of
from gateway.views.hmi.html.render import render
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from gateway.views.hmi.texts import text_of


class LoginRequests:
    """The endpoints."""

    def __init__(self, sessions: LoginSessions, *, https: bool) -> None:
        self._sessions, self._https = sessions, https
        self._logins = Logins(sessions.users) if sessions.users is not None else None

    def routes(self) -> list[Route]:
        """Return the routes of the requests."""
        return [
            Route("/login", self.login, methods=["POST"]),
            Route("/logout", self.logout, methods=["POST"]),
            Route("/login", self.login_form, methods=["GET"]),
            Route("/api/session", self.session, methods=["GET"]),
        ]

    async def session(self, request: Request) -> Response:
        """Return the user and the remaining time of the session."""
        session = session_of(request)
        left_s = self._sessions.left_s(session, time.monotonic())
        return JSONResponse(
            {"name": session.name, "role": self._sessions.role(session).word, "left_s": round(left_s)},
            headers={"cache-control": "no-store"},
        )

    async def login_form(self, request: Request) -> Response:
        """Return the login form."""
        if self._logins is None:
            return RedirectResponse("/", status_code=303)
        query = request.query_params
        message = text_of("login.over") if "over" in query else ""
        return render("login.html", {"message": message, "next": local_page(query.get("next", "/"))})

    async def login(self, request: Request) -> Response:
        """Check name and password, and open a session."""
        if self._logins is None:
            return RedirectResponse("/", status_code=303)
        fields = parse_qs((await request.body())[:4096].decode("utf-8", errors="replace"))
        name, password, target = (fields.get(field, [""])[0] for field in ("name", "password", "next"))
        then = local_page(target)
        host = request.client.host if request.client is not None else ""
        browser = self._sessions.held(request.cookies.get(cookie_name(_host(request)), ""), name)
        user = await self._logins.login(name, password, host, browser=browser)
        if isinstance(user, TooMany):
            message = text_of("login.too_many", seconds=f"{user.wait_s:.0f}")
            return render("login.html", {"message": message, "next": then}, status=429)
        if user is None:
            return render("login.html", {"message": text_of("login.wrong"), "next": then}, status=401)
        session = self._sessions.open(user.name, user.role, time.monotonic())
        return RedirectResponse(then, status_code=303, headers={"set-cookie": self._cookie(session, request)})

    async def logout(self, request: Request) -> Response:
        """End the session."""
        self._sessions.close(session_of(request))
        return JSONResponse({"accepted": True}, headers={"set-cookie": self._cookie(None, request)})

    def _cookie(self, session: LoginSession | None, request: Request) -> str:
        return session_cookie(session, _host(request), lifetime_s=self._sessions.lifetime_s, https=self._https)


def _host(request: Request) -> str:
    return str(request.headers.get("host", ""))
