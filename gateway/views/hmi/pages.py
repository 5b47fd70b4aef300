"""The pages: overview, rig, replay, logs.  What moves is drawn by static/hmi.js; here stand frames, words and controls.

Rule 1: a control that the session may not use is not on its page; `console.py` refuses it as well.
Rule 2: handlers hand the work to a thread: one slow answer of a board must not stop the frames of the others.
"""

from __future__ import annotations

import asyncio
import html
from collections.abc import Awaitable, Callable

from nicegui import ui
from starlette.requests import Request

from gateway.views.hmi import controls
from gateway.views.hmi.console import Console
from gateway.views.hmi.controls import Place, tell
from gateway.views.hmi.library import Entry
from gateway.views.hmi.sessions import Session
from protocol.bus import board51_pb2 as pb

REPLAY = "/live-replay"  # where the frames of replays come from
SUMMARY_MAX_BYTES = 200_000_000  # a larger log takes minutes to read: `board51 info` does it


def register(console: Console) -> None:
    """Declare the pages to NiceGUI."""

    @ui.page("/", title="Board51")
    def overview(request: Request) -> None:
        session = _begin(request, live="/live", prefix="/rig")
        _bar(console, session, "All rigs")
        _lost()
        _part("overview", "boards")

    @ui.page("/rig/{board}", title="Board51 rig")
    async def rig(request: Request, board: str) -> None:
        reports = await asyncio.to_thread(console.reports.entries)
        place = Place(console=console, session=_begin(request, live=f"/live/{board}", board=board,
                      stop=console.may(_session(request), "stop")), board=board)  # fmt: skip
        _bar(console, place.session, board, live=True, stop=console.may(place.session, "stop"))
        _lost()
        _rig(place, reports[0] if reports else None)

    @ui.page("/replay/", title="Board51 replay")
    def replays(request: Request) -> None:
        session = _begin(request, live=REPLAY, prefix="/replay")
        _bar(console, session, "Replay")
        _replay_banner(console, session)
        _lost()
        _part("overview", "boards")

    @ui.page("/replay/{board}", title="REPLAY, not live")
    def replay(request: Request, board: str) -> None:
        session = _begin(request, live=f"{REPLAY}/{board}", board=board)
        _bar(console, session, f"{board}, replayed", live=True)
        _replay_banner(console, session)
        _lost()
        with ui.element("main").classes("rig replayed"):
            _measured()
            with ui.element("div").classes("side"):
                _list("Alarms", "alarms")
                _list("Events", "events")
                _list("Commands", "commands")

    @ui.page("/logs", title="Board51 logs")
    async def logs(request: Request) -> None:
        session = _begin(request, live="/live", prefix="/rig")
        _bar(console, session, "Logs and reports")
        await _logs(console, session)


def _session(request: Request) -> Session:
    session: Session = request.scope["board51_session"]  # the guard has seen to it
    return session


def _begin(request: Request, *, live: str, board: str = "", stop: bool = False, prefix: str = "") -> Session:
    """What every page needs: its session, and its script with what it must know."""
    session = _session(request)
    ui.colors(primary="#0b57a4", positive="#1f6b3a", negative="#b3261e")
    session.pages.add(ui.context.client.id)
    ui.context.client.on_delete(lambda client=ui.context.client: session.pages.discard(client.id))
    facts = {"board": board, "token": session.csrf, "live": live, "stop": "yes" if stop else "", "prefix": prefix,
             "replay": "yes" if live.startswith(REPLAY) else ""}  # fmt: skip
    data = " ".join(f'data-{name}="{html.escape(value, quote=True)}"' for name, value in facts.items())
    ui.add_head_html(
        f'<meta name="board51" {data}><link rel="stylesheet" href="/static/hmi.css">'
        '<script type="module" src="/static/hmi.js"></script>'
    )
    return session


def _live(name: str, tag: str = "span", classes: str = "") -> ui.element:
    """An element that hmi.js fills."""
    return ui.element(tag).classes(classes).props(f'data-live="{name}"')


def _bar(console: Console, session: Session, title: str, *, live: bool = False, stop: bool = False) -> None:
    with ui.element("header").classes("bar"):
        with ui.element("div").classes("bar-row"):
            with ui.element("a").props('href="/"').classes("home"):
                ui.label("Board51")
            ui.label(title).classes("title")
            if live:
                for name in ("link", "to-board", "mode", "twin", "log", "alarm-count"):
                    _live(name, classes="chip")
            ui.element("div").classes("space")
            with ui.element("nav"):
                for text, target in (("Rigs", "/"), ("Logs", "/logs"), ("Replay", "/replay/")):
                    ui.link(text, target)
            ui.label(f"{session.name}, {console.role(session).word}").classes("who")
            if console.users is not None:
                ui.button("Log out", on_click=lambda: _log_out(console, session)).props(
                    "flat dense no-caps color=white"
                )
        if stop:
            with ui.element("button").classes("stop").props('data-act="stop" type="button" aria-keyshortcuts="Escape"'):
                ui.html('<svg viewBox="0 0 24 24" aria-hidden="true"><path d="M8 1h8l7 7v8l-7 7H8l-7-7V8z"/></svg>',
                        sanitize=False)  # fmt: skip
                ui.label("STOP").classes("stop-word")
                ui.label("key: Esc").classes("stop-key")
    _live("stop-said", "div", "said").props('role="alert"')
    _live("session", "div", "said")


def _log_out(console: Console, session: Session) -> None:
    console.sessions.close(session)
    ui.navigate.to("/login")


def _lost() -> None:
    _live("lost", "div", "lost").props('role="status"')


def _part(classes: str, live: str) -> None:
    with ui.element("main").classes(classes):
        _live(live, "div", "boards")


def _rig(place: Place, report: Entry | None) -> None:
    with ui.element("main").classes("rig"):
        _measured()
        with ui.element("div").classes("side"):
            _list("Alarms", "alarms")
            controls.steering(place)
            controls.recording(place)
            controls.campaign(place)
            controls.gains(place)
            if report is not None:
                with ui.element("section").classes("card"):
                    ui.label("Diagnosis").classes("card-title")
                    ui.link(f"Last report, {report.changed}", f"/report/{report.name}", new_tab=True)
    with ui.element("div").classes("below"):
        _list("Events", "events")
        _list("Commands: who did what", "commands")
        _list("Link, log, board", "health")


def _measured() -> None:
    with ui.element("div").classes("ball-card card"):
        _live("ball", "div", "ball-drawing")
        with ui.element("div").classes("numbers"):
            for name, title, unit, big in (
                ("x", "position", "mm", True), ("x_ref", "reference", "mm", False), ("twin_x", "twin", "mm", False),
                ("i_c", "current", "A", False), ("u_c", "input", "V", False),
                ("error_x", "x \u2212 twin", "\u00b5m", False), ("error_i", "i \u2212 twin", "mA", False),
            ):  # fmt: skip
                with ui.element("div").classes("number big" if big else "number"):
                    ui.label(title).classes("number-title")
                    with ui.element("div").classes("number-value"):
                        _live(name)
                        ui.label(unit).classes("unit")
        _live("flags", "div", "flags")
    with ui.element("div").classes("plots card"):
        for name in ("plot-x", "plot-i", "plot-d"):
            _live(name, "canvas", name)


def _list(title: str, name: str) -> None:
    with ui.element("section").classes(f"card list {name}"):
        ui.label(title).classes("card-title")
        _live(name, "div", "entries")


def _replay_banner(console: Console, session: Session) -> None:
    job = console.jobs.get("replay", "*")
    what = f"{job.title} ({job.standing})" if job is not None else "nothing was replayed yet: choose a log under Logs"
    with ui.element("div").classes("replay-banner"):
        ui.label(f"\u25b6 REPLAY of a recording, NOT LIVE: {what}")
        if job is not None and job.running:
            controls.act("End replay", lambda: console.stop_job(session, "replay", "*"))


async def _logs(console: Console, session: Session) -> None:
    entries = await asyncio.to_thread(console.logs.entries)
    reports = await asyncio.to_thread(console.reports.entries)
    with ui.element("main").classes("library"):
        with ui.element("section").classes("card"):
            ui.label("Diagnosis reports").classes("card-title")
            for entry in reports[:20]:
                with ui.element("div").classes("file"):
                    ui.link(f"{entry.path.parent.name}/{entry.path.name}", f"/report/{entry.name}", new_tab=True)
                    ui.label(entry.changed).classes("at")
            if not reports:
                ui.label("None yet. `board51 diagnose ... --out DIR` writes one; give DIR with --reports.").classes(
                    "empty"
                )
        with ui.element("section").classes("card"):
            ui.label("Logs").classes("card-title")
            if not entries:
                ui.label("There are no logs in this folder yet.").classes("empty")
            for entry in entries:
                with ui.element("div").classes("file"):
                    ui.label(entry.name).classes("file-name")
                    ui.label(f"{entry.changed}, {entry.bytes / 1e6:.1f} MB").classes("at")
                    with ui.element("div").classes("file-acts"):
                        ui.button("Summary", on_click=_summary(console, entry.name)).props("outline dense no-caps")
                        controls.act("Replay", _replay(console, session, entry.name), then="/replay/")
                        ui.link("Download", f"/log/{entry.name}")


def _replay(console: Console, session: Session, name: str) -> Callable[[], pb.CommandReply]:
    return lambda: console.start_replay(session, name, 1.0)


def _summary(console: Console, name: str) -> Callable[[], Awaitable[None]]:
    async def show() -> None:
        """Reading a log is work for seconds: a process of its own, so that no frame waits for it."""
        entry = await asyncio.to_thread(console.logs.find, name)
        if entry is None:
            tell(pb.CommandReply(text="There is no such log any longer."))
            return
        if entry.bytes > SUMMARY_MAX_BYTES:
            tell(pb.CommandReply(text=f"{entry.bytes / 1e6:.0f} MB take long to read: use `board51 info`."))
            return
        with ui.dialog() as dialog, ui.card().classes("summary"):
            ui.label(name).classes("file-name")
            text = ui.label("reading \u2026").classes("summary-text")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.open()
        said = await asyncio.to_thread(console.summary, entry)
        if not dialog.is_deleted:
            text.text = said

    return show
