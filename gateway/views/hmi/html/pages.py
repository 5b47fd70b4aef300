"""The pages: overview, rig, replay, logs, report.  What moves is drawn by static/hmi.js; here stand frames and words.

Rule 1: a control that the session may not use is not on its page; `actions.py` refuses it as well.
Rule 2: a page holds no state in the server: what it sends is a request of its own, so it works after any gap.
Rule 3: every page has STOP and the key Esc: for its rig, or, where it belongs to none, for all rigs of the site.
Rule 4: what comes and goes has its place: nothing may push a button away from under a finger.
"""

from __future__ import annotations

import asyncio
import time

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from gateway.access.roles import MINIMUM_ROLE
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.guard import refusal
from gateway.views.hmi.html import controls, model_page
from gateway.views.hmi.html.markup import Markup, join, tag
from gateway.views.hmi.library import LibraryFile
from gateway.views.hmi.model.campaigns import choose, rig_of
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.sessions import LoginSession
from protocol.diagnosis import load_diagnosis
from protocol.errors import DataError

REPLAY = "/live-replay"  # where the frames of replays come from
MAX_REPORTS = 20
_CHIPS = ("link", "to-board", "mode", "runs", "twin", "log", "alarm-count")
_NUMBERS = (
    ("x", "position", "mm", True), ("x_ref", "reference", "mm", False), ("twin_x", "twin", "mm", False),
    ("i_c", "current", "A", False), ("u_c", "input", "V", False),
    ("error_x", "x \u2212 twin", "\u00b5m", False), ("error_i", "i \u2212 twin", "mA", False),
)  # fmt: skip
_SPANS = ((5, "5 s"), (20, "20 s"), (60, "1 min"), (600, "10 min"))
_ICON = Markup('<svg viewBox="0 0 24 24" aria-hidden="true"><path d="M8 1h8l7 7v8l-7 7H8l-7-7V8z"/></svg>')


class Pages:
    """The pages of one server."""

    def __init__(self, actions: Actions, work: ModelWork) -> None:
        self._actions, self._work = actions, work

    def routes(self) -> list[Route]:
        """Return the routes of the pages."""
        pages = {
            "/": self.overview,
            "/rig/{board}": self.rig,
            "/model/{board}": self.model,
            "/replay/": self.replays,
            "/replay/{board}": self.replay,
            "/logs": self.logs,
            "/report/{name:path}": self.report,
        }
        return [Route(path, endpoint, methods=["GET"]) for path, endpoint in pages.items()]

    async def overview(self, request: Request) -> Response:
        """Return the page of all rigs."""
        return self._page(request, "All rigs", _boards(), live="/live", prefix="/rig")

    async def rig(self, request: Request) -> Response:
        """Return the page of one rig, with the controls that this session may use."""
        board, session = request.path_params["board"], _session(request)
        reports = [entry for entry in await asyncio.to_thread(self._actions.reports.entries) if rig_of(entry) == board]
        cards = controls.cards(lambda act: self._actions.may(session, act))
        body = tag(
            "main",
            _measured(),
            tag("div", _list("Alarms", "alarms"), _to_model(board, reports), *cards, class_="side"),
            tag("div", _list("Events", "events"), _list("Commands: who did what", "commands"),
                _list("Link, log, board", "health"), class_="below"),
            class_="rig",
        )  # fmt: skip
        return self._page(request, board, body, live=f"/live/{board}", board=board, chips=True)

    async def model(self, request: Request) -> Response:
        """Return the page of a rig's model: from a campaign to an extended model."""
        board, session = request.path_params["board"], _session(request)
        body = await asyncio.to_thread(self._model, board, request.query_params.get("campaign", ""), session)
        return self._page(
            request, f"Model of {board}", body, live=f"/live/{board}", board=board, chips=True, script="model.js"
        )

    def _model(self, board: str, campaign: str, session: LoginSession) -> Markup:
        campaigns = self._work.campaigns(board)
        chosen = choose(campaigns, campaign)
        diagnosis, problem, report = None, "", ""
        if chosen is not None and chosen.diagnosis is not None:
            try:
                diagnosis = load_diagnosis(chosen.diagnosis)
            except DataError as error:
                problem = str(error)
            page = (chosen.diagnosis.parent / "report.html").resolve()
            report = next((entry.name for entry in self._actions.reports.entries() if entry.path == page), "")

        def may(act: str) -> bool:
            return self._actions.may(session, act)

        return model_page.page(
            self._work.running(board),
            model_page.steps(chosen, may),
            model_page.diagnosis_card(chosen, diagnosis, problem, report, may),
            model_page.models_card(self._work.models(board), may),
            model_page.campaigns_card(board, campaigns, chosen, may),
        )

    async def replays(self, request: Request) -> Response:
        """Return the page of all replayed rigs."""
        return self._page(request, "Replay", self._replay_banner(), _boards(), live=REPLAY, prefix="/replay")

    async def replay(self, request: Request) -> Response:
        """Return the page of one rig of a recording."""
        board = request.path_params["board"]
        lists = (_list("Alarms", "alarms"), _list("Events", "events"), _list("Commands", "commands"))
        body = tag("main", _measured(), tag("div", *lists, class_="side"), class_="rig replayed")
        title = f"{board}, replayed"
        return self._page(
            request, title, self._replay_banner(), body, live=f"{REPLAY}/{board}", board=board, chips=True
        )

    async def logs(self, request: Request) -> Response:
        """Return the page of reports and logs."""
        session = _session(request)
        logs = await asyncio.to_thread(self._actions.logs.entries)
        reports = await asyncio.to_thread(self._actions.reports.entries)
        body = tag(
            "main",
            _card("Diagnosis reports", *map(_report_row, reports[:MAX_REPORTS]), empty=self._how_to_report()),
            _card(
                "Logs",
                *([_filter()] if logs else []),
                *(_log_row(entry, deletable=self._actions.may(session, "delete_log")) for entry in logs),
                empty="There are no logs in this folder yet.",
            ),
            tag("dialog", tag("div", class_="file-name"), tag("pre", class_="summary-text"),
                tag("button", "Close", type="button", class_="plain", data_act="close"), class_="summary card"),
            class_="library",
        )  # fmt: skip
        return self._page(request, "Logs and reports", body, live="/live")

    async def report(self, request: Request) -> Response:
        """Return a report within a page that has STOP; the report itself runs no script."""
        entry = await asyncio.to_thread(self._actions.reports.find, request.path_params["name"])
        if entry is None:
            return refusal(404, "no-report", "There is no such report.")
        frame = tag("iframe", src=f"/report-file/{entry.name}", title="Report", sandbox="allow-same-origin")
        body, title = tag("main", frame, class_="report"), f"Report of {entry.changed}"
        rig = rig_of(entry)
        if self._actions.feed.board(rig) is None:  # of a rig that is not here: its STOP would stop nothing
            return self._page(request, title, body, live="/live")
        return self._page(request, f"{rig}, {title.lower()}", body, live=f"/live/{rig}", board=rig)

    def _how_to_report(self) -> str:
        folder = self._actions.reports.folders[0]
        command = f"board51 diagnose CAMPAIGN --model MODEL --out {folder}/NAME"
        return f"None yet. Press Diagnose on the page of a rig's model, or use `{command}`."

    def _replay_banner(self) -> Markup:
        job = self._actions.jobs.get("replay", "*")
        what = job.title if job is not None else "nothing was replayed yet: choose a log under Logs"
        end = controls.job("End replay", "replay", "stop") if job is not None and job.running else ""
        return tag("div", tag("span", f"\u25b6 REPLAY of a recording, NOT LIVE: {what}"), end, class_="replay-banner")

    def _page(
        self,
        request: Request,
        title: str,
        *body: Markup,
        live: str,
        board: str = "",
        prefix: str = "",
        chips: bool = False,
        script: str = "",
    ) -> Response:
        session, replayed = _session(request), live.startswith(REPLAY)
        role = self._actions.role(session)
        stops = board if board and not replayed else "*"
        head = join(
            tag("meta", charset="utf-8"),
            tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
            tag("title", f"{title}, Board51" if not replayed else "REPLAY, not live"),
            tag("link", rel="icon", href="/static/icon.svg"),
            tag("script", src="/static/theme.js"),
            tag("link", rel="stylesheet", href="/static/vendor/uPlot.min.css") if chips else "",
            tag("link", rel="stylesheet", href="/static/hmi.css"),
            tag("meta", name="board51", data_board=board, data_token=session.csrf, data_live=live, data_prefix=prefix,
                data_replay="yes" if replayed else "", data_stops=stops, data_now=f"{time.monotonic():.3f}",
                data_may="" if replayed else " ".join(a for a in MINIMUM_ROLE if self._actions.may(session, a))),
            tag("script", src="/static/vendor/uPlot.iife.min.js") if chips else "",
            tag("script", type="module", src="/static/hmi.js"),
            tag("script", type="module", src=f"/static/{script}") if script else "",
        )  # fmt: skip
        links = [tag("a", text, href=to) for text, to in (("Rigs", "/"), ("Logs", "/logs"), ("Replay", "/replay/"))]
        row = tag(
            "div",
            tag("a", "Board51", href="/", class_="home"),
            tag("h1", title, class_="title"),
            tag("nav", *links),
            tag("button", "Light / dark", type="button", class_="plain", data_theme_switch="yes"),
            tag("span", f"{session.name}, {role.word}", class_="who"),
            tag("button", "Log out", type="button", data_act="log-out", class_="plain") if self._actions.users else "",
            class_="bar-row",
        )
        chip_row = tag("div", *(_live(name, class_="chip") for name in _CHIPS), class_="chips") if chips else ""
        messages = [_live(name, "div", class_="said", role="alert") for name in ("stop-said", "lost", "session")]
        content = join(
            tag("header", tag("div", row, chip_row, class_="bar-rows"), _stop(stops, replayed), class_="bar"),
            tag("div", tag("span", _what_stops(stops, replayed), class_="hint"), tag("div", *messages, class_="stack"),
                class_="messages"),
            *body,
            tag("div", class_="toasts", role="status"),
        )  # fmt: skip
        text = f"<!doctype html>{tag('html', tag('head', head), tag('body', content), lang='en')}"
        return HTMLResponse(text, headers={"cache-control": "no-store"})


def _session(request: Request) -> LoginSession:
    session: LoginSession = request.scope["board51_session"]  # the guard has seen to it
    return session


def _stop(stops: str, replayed: bool) -> Markup:
    words = tag("span", "STOP", class_="stop-word"), tag("span", _coils(stops, replayed), class_="stop-key")
    return tag(
        "button", _ICON, *words,
        type="button", class_="stop", data_act="stop", data_board=stops, aria_keyshortcuts="Escape",
    )  # fmt: skip


def _coils(stops: str, replayed: bool) -> str:
    return stops if stops != "*" else "all live rigs" if replayed else "all rigs"


def _what_stops(stops: str, replayed: bool) -> str:
    if stops != "*":
        return f"STOP or Esc: the coil of {stops} off, at once."
    return (
        f"STOP or Esc: the coils of {_coils(stops, replayed)} off, at once: this page does not belong to a single rig."
    )


def _live(name: str, element: str = "span", **attributes: str) -> Markup:
    """Return an element that hmi.js fills."""
    return tag(element, data_live=name, **attributes)


def _card(title: str, *content: Markup, empty: str) -> Markup:
    rows = content or (tag("div", empty, class_="empty"),)
    return tag("section", tag("h2", title, class_="card-title"), *rows, class_="card")


def _boards() -> Markup:
    return tag("main", _live("boards", "div", class_="boards"), class_="overview")


def _measured() -> Markup:
    numbers = [
        tag("div", tag("div", title, class_="number-title"),
            tag("div", _live(name), tag("span", unit, class_="unit"), class_="number-value"),
            class_="number big" if big else "number")
        for name, title, unit, big in _NUMBERS
    ]  # fmt: skip
    ball = (_live("ball", "div", class_="ball-drawing"), tag("div", *numbers, class_="numbers"))
    plots = [_live(name, "div", class_=f"plot {name}") for name in ("plot-x", "plot-i", "plot-d")]
    spans = [tag("button", text, type="button", class_="span-of", data_span=str(s)) for s, text in _SPANS]
    bar = tag("div", tag("span", "Time span", class_="hint"), *spans,
              tag("button", "Pause", type="button", class_="span-of", data_pause="yes"),
              tag("span", "drag: zoom, double click: back", class_="hint"), class_="plot-bar")  # fmt: skip
    return join(
        tag("div", *ball, _live("flags", "div", class_="flags"), class_="ball-card card"),
        tag("div", bar, *plots, class_="plots card"),
    )


def _list(title: str, name: str) -> Markup:
    entries = _live(name, "div", class_="entries", tabindex="0", aria_label=title)
    return tag("section", tag("h2", title, class_="card-title"), entries, class_=f"card list {name}")


def _to_model(board: str, reports: list[LibraryFile]) -> Markup:
    links = [tag("a", "Campaign, diagnosis, hand-over", href=f"/model/{board}")]
    links += [tag("a", f"Last report, {entry.changed}", href=f"/report/{entry.name}") for entry in reports[:1]]
    return _card("Model", _live("wrong", "div", class_="wrong"), *(tag("div", link) for link in links), empty="")


def _report_row(entry: LibraryFile) -> Markup:
    rig = rig_of(entry)
    title = f"{rig}, campaign {entry.path.parent.parent.name}" if rig else f"{entry.path.parent.name}/{entry.path.name}"
    link = tag("a", title, href=f"/report/{entry.name}")
    return tag("div", link, tag("span", entry.changed, class_="at"), class_="file")


def _filter() -> Markup:
    field = tag("input", type="text", data_filter="log", autocomplete="off", placeholder="part of a name or date")
    return tag("label", tag("span", "Show logs with"), field, class_="field")


def _log_row(entry: LibraryFile, *, deletable: bool) -> Markup:
    acts = (
        tag("button", "Summary", type="button", class_="plain", data_act="summary", data_log=entry.name),
        controls.job("Replay", "replay", "start", log=entry.name, then="/replay/"),
        tag("a", "Download", href=f"/log/{entry.name}"),
        tag("button", "Delete", type="button", class_="plain", data_act="delete", data_log=entry.name)
        if deletable and not entry.name.startswith("campaigns/")
        else "",
    )
    size = f"{entry.changed}, {entry.bytes / 1e6:.1f} MB"
    return tag("div", tag("span", entry.name, class_="file-name"), tag("span", size, class_="at"),
               tag("div", *acts, class_="file-acts"), class_="file log")  # fmt: skip
