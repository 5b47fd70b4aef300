"""The web server: guard, pages, requests and live frames around one client of the bus.

It makes no decisions about the rig: `actions.py` checks the table of rights, and the gateway checks it again.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import uvicorn
import zenoh
from starlette.applications import Starlette
from starlette.routing import BaseRoute, Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from gateway.access.listeners import allow_restart
from gateway.access.roles import Role
from gateway.access.users import Users
from gateway.views.feed import Feed
from gateway.views.hmi import metrics
from gateway.views.hmi.actions import REPLAY_SITE, Actions, Routes
from gateway.views.hmi.acts import Acts
from gateway.views.hmi.api.recent import LOOK_S, Samples
from gateway.views.hmi.api.routes import Api, not_there, release
from gateway.views.hmi.guard import MAX_BODY, Guard
from gateway.views.hmi.html.pages import REPLAY, Pages
from gateway.views.hmi.jobs import Job, Jobs
from gateway.views.hmi.library import Library
from gateway.views.hmi.live import REST_S, STUCK_S, Live, follow
from gateway.views.hmi.login_requests import LoginRequests
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.programs import Programs
from gateway.views.hmi.refusals import RefusalError, refused
from gateway.views.hmi.requests import Requests
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from gateway.views.hmi.traces import Traces
from protocol.bus.identity import login_name
from protocol.ending import on_end_signal
from protocol.errors import ServiceError

REPORTS = ("report.html", "bode.html", "compare.html", "what_if.html")  # of diagnose, bode, compare, what-if
STATIC = Path(__file__).parent / "static"
END_S = 2  # time for open connections at the end
MAX_CONNECTIONS = 256  # beyond it: 503
SEND_BUFFER = 16_384  # bytes that the system holds for a browser that does not read: a second or two of frames


@dataclass(frozen=True, kw_only=True)
class HmiSettings:
    """The settings of one server."""

    users: Users | None  # None: every client is the local operator
    guarded: bool  # the bus has roles
    certificate: Path | None
    key: Path | None
    reports: tuple[Path, ...]
    idle_s: float
    lifetime_s: float
    loopback: bool
    routes: Routes


def serve(settings: HmiSettings, listener: socket.socket, bus: zenoh.Session, replay_bus: zenoh.Session) -> None:
    """Serve until SIGTERM or SIGINT."""
    jobs = Jobs()
    feeds = Feed(bus, settings.routes.site, guarded=settings.guarded), Feed(replay_bus, REPLAY_SITE, replays=True)
    config = uvicorn.Config(
        build(settings, *feeds, jobs),
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        ws="websockets-sansio",
        ws_max_size=MAX_BODY,
        timeout_graceful_shutdown=END_S,
        limit_concurrency=MAX_CONNECTIONS,
        ssl_certfile=settings.certificate,
        ssl_keyfile=settings.key,
    )
    server = uvicorn.Server(config)
    # uvicorn has its own handlers while it serves, and raises the signal once more when it has put ours back.
    on_end_signal(partial(setattr, server, "should_exit", True))
    try:
        server.run(sockets=[listener])
    finally:
        jobs.close()
        for feed in feeds:
            feed.close()


def build(settings: HmiSettings, feed: Feed, replayed: Feed, jobs: Jobs) -> ASGIApp:
    """The application, without a server around it."""
    users, data = settings.users, settings.routes.data
    sessions = LoginSessions(users, idle_s=settings.idle_s, lifetime_s=settings.lifetime_s)
    actions = Actions(
        feed,
        sessions,
        jobs=jobs,
        logs=Library(
            {"logs": settings.routes.logs} | {name: data / name for name in ("recordings", "campaigns")}, "*.mcap"
        ),
        reports=Library({str(n): path for n, path in enumerate(settings.reports)}, *REPORTS),
        routes=settings.routes,
        replayed=replayed,
    )

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        traced = (follow(source, REST_S, lambda board: board.companion(Traces).pump()) for source in (feed, replayed))
        recent = follow(feed, LOOK_S, lambda board: board.companion(Samples))
        pumps = [asyncio.create_task(pump) for pump in (*traced, recent)]
        yield
        for pump in pumps:
            pump.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await pump

    work = ModelWork(actions)
    acts = Acts(actions)
    https = settings.certificate is not None
    requests, api = Requests(actions, acts, work), Api(actions, acts, work)
    logins = LoginRequests(sessions, https=https)
    static = Mount("/static", StaticFiles(directory=STATIC))
    pages = Pages(actions, work, api.document)
    sockets = [*_frames("/live", feed, sessions, jobs.of), *_frames(REPLAY, replayed, sessions, lambda _: jobs.of("*"))]
    endpoints = [route for part in (api, requests, logins, pages) for route in part.routes()]
    routes = [static, metrics.route(feed, release()), *sockets, *endpoints]
    return Guard(
        Starlette(lifespan=lifespan, routes=routes, exception_handlers={404: not_there, RefusalError: refused}),
        sessions,
        Programs(sessions),
        newcomer=None if users is not None else lambda: _local(sessions),
        loopback=settings.loopback,
        https=https,
    )


def _frames(prefix: str, feed: Feed, sessions: LoginSessions, jobs: Callable[[str], Sequence[Job]]) -> list[BaseRoute]:
    readers = Live(feed, sessions, jobs)
    return [
        WebSocketRoute(prefix, readers.overview),
        WebSocketRoute(f"{prefix}/{{board}}", readers.board),
        WebSocketRoute(f"{prefix}/{{board}}/spectrum", readers.spectrum),
    ]


def _local(sessions: LoginSessions) -> LoginSession:
    """Open a session for the user of this machine, as `board51 send` does."""
    return sessions.open(login_name("local operator"), Role.ENGINEER, time.monotonic())


def listen(host: str, port: int) -> socket.socket:
    """A listening socket.

    Raises:
        ServiceError: the port is in use or may not be opened.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    allow_restart(listener)
    # Connections inherit both.  Without the second option a connection that reads nothing stays for ever, because its
    # close waits behind the bytes before it.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(STUCK_S * 1e3))
    try:
        listener.bind((host, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise ServiceError(
            f"Cannot listen on {host}:{port}: {error.strerror or error}",
            remedy="End what uses the port, or give another one with --listen HOST:PORT",
        ) from None
    return listener
