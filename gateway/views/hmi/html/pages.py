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
from gateway.views.hmi.texts import for_scripts, text_of, texts_of
from protocol.diagnosis import load_diagnosis
from protocol.errors import DataError

REPLAY = "/live-replay"  # where the frames of replays come from
MAX_REPORTS = 20
_CHIPS = ("link", "to-board", "mode", "runs", "twin", "log", "alarm-count")
_NUMBERS = (
    ("x", "rig.position", "mm", True), ("x_ref", "rig.reference", "mm", False), ("twin_x", "rig.twin", "mm", False),
    ("i_c", "rig.current", "A", False), ("u_c", "rig.input", "V", False),
    ("error_x", "rig.x_minus_twin", "\u00b5m", False), ("error_i", "rig.i_minus_twin", "mA", False),
)  # fmt: skip
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
        return self._page(request, text_of("title.overview"), _boards(), live="/live", prefix="/rig")

    async def rig(self, request: Request) -> Response:
        """Return the page of one rig, with the controls that this session may use."""
        board, session = request.path_params["board"], _session(request)
        reports = [entry for entry in await asyncio.to_thread(self._actions.reports.entries) if rig_of(entry) == board]
        cards = controls.cards(lambda act: self._actions.may(session, act))
        body = tag(
            "main",
            _measured(),
            tag("div", _list(text_of("rig.alarms"), "alarms"), _to_model(board, reports), *cards, class_="side"),
            tag("div", _list(text_of("rig.events"), "events"), _list(text_of("rig.commands"), "commands"),
                _list(text_of("rig.health"), "health"), class_="below"),
            class_="rig",
        )  # fmt: skip
        return self._page(request, board, body, live=f"/live/{board}", board=board, chips=True)

    async def model(self, request: Request) -> Response:
        """Return the page of a rig's model: from a campaign to an extended model."""
        board, session = request.path_params["board"], _session(request)
        body = await asyncio.to_thread(self._model, board, request.query_params.get("campaign", ""), session)
        title = text_of("title.model", rig=board)
        return self._page(request, title, body, live=f"/live/{board}", board=board, chips=True, script="model.js")

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
        title = text_of("title.replay")
        return self._page(request, title, self._replay_banner(), _boards(), live=REPLAY, prefix="/replay")

    async def replay(self, request: Request) -> Response:
        """Return the page of one rig of a recording."""
        board = request.path_params["board"]
        lists = (_list(text_of("rig.alarms"), "alarms"), _list(text_of("rig.events"), "events"),
                 _list(text_of("rig.commands_replayed"), "commands"))  # fmt: skip
        body = tag("main", _measured(), tag("div", *lists, class_="side"), class_="rig replayed")
        title = text_of("title.replay_of", rig=board)
        return self._page(
            request, title, self._replay_banner(), body, live=f"{REPLAY}/{board}", board=board, chips=True
        )

    async def logs(self, request: Request) -> Response:
        """Return the page of reports and logs."""
        session = _session(request)
        logs = await asyncio.to_thread(self._actions.logs.entries)
        reports = await asyncio.to_thread(self._actions.reports.entries)
        close = tag("button", text_of("library.close"), type="button", class_="plain", data_act="close")
        body = tag(
            "main",
            _card(text_of("library.reports"), *map(_report_row, reports[:MAX_REPORTS]), empty=self._how_to_report()),
            _card(
                text_of("library.logs"),
                *([_filter()] if logs else []),
                *(_log_row(entry, deletable=self._actions.may(session, "delete_log")) for entry in logs),
                empty=text_of("library.no_logs"),
            ),
            tag(
                "dialog",
                tag("div", class_="file-name"),
                tag("pre", class_="summary-text"),
                close,
                class_="summary card",
            ),
            class_="library",
        )
        return self._page(request, text_of("title.library"), body, live="/live")

    async def report(self, request: Request) -> Response:
        """Return a report within a page that has STOP; the report itself runs no script."""
        entry = await asyncio.to_thread(self._actions.reports.find, request.path_params["name"])
        if entry is None:
            return refusal(404, "no-report", text_of("refusal.no_report"))
        frame = tag(
            "iframe", src=f"/report-file/{entry.name}", title=text_of("library.frame"), sandbox="allow-same-origin"
        )
        body, title = tag("main", frame, class_="report"), text_of("title.report", date=entry.changed)
        rig = rig_of(entry)
        if self._actions.feed.board(rig) is None:  # of a rig that is not here: its STOP would stop nothing
            return self._page(request, title, body, live="/live")
        title = text_of("title.report_of", rig=rig, date=entry.changed)
        return self._page(request, title, body, live=f"/live/{rig}", board=rig)

    def _how_to_report(self) -> str:
        folder = self._actions.reports.folders[0]
        command = f"board51 diagnose CAMPAIGN --model MODEL --out {folder}/NAME"
        return text_of("library.no_reports", command=command)

    def _replay_banner(self) -> Markup:
        job = self._actions.jobs.get("replay", "*")
        text = text_of("bar.replaying_nothing") if job is None else text_of("bar.replaying", log=job.title)
        running = job is not None and job.running
        end = controls.job(text_of("bar.end_replay"), "replay", "stop") if running else ""
        return tag("div", tag("span", text), end, class_="replay-banner")

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
            tag("title", text_of("title.document_replay") if replayed else text_of("title.document", page=title)),
            tag("link", rel="icon", href="/static/icon.svg"),
            tag("script", src="/static/theme.js"),
            tag("link", rel="stylesheet", href="/static/vendor/uPlot.min.css") if chips else "",
            tag("link", rel="stylesheet", href="/static/hmi.css"),
            tag("meta", name="board51", data_board=board, data_token=session.csrf, data_live=live, data_prefix=prefix,
                data_replay="yes" if replayed else "", data_stops=stops, data_now=f"{time.monotonic():.3f}",
                data_may="" if replayed else " ".join(a for a in MINIMUM_ROLE if self._actions.may(session, a)),
                data_texts=for_scripts()),
            tag("script", src="/static/vendor/uPlot.iife.min.js") if chips else "",
            tag("script", type="module", src="/static/hmi.js"),
            tag("script", type="module", src=f"/static/{script}") if script else "",
        )  # fmt: skip
        pages = (text_of("bar.rigs"), "/"), (text_of("bar.logs"), "/logs"), (text_of("bar.replay"), "/replay/")
        links = [tag("a", text, href=to) for text, to in pages]
        row = tag(
            "div",
            tag("a", text_of("bar.home"), href="/", class_="home"),
            tag("h1", title, class_="title"),
            tag("nav", *links),
            tag("button", text_of("bar.theme"), type="button", class_="plain", data_theme_switch="yes"),
            tag("span", text_of("bar.who", name=session.name, role=role.word), class_="who"),
            _log_out() if self._actions.users else "",
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


def _log_out() -> Markup:
    return tag("button", text_of("bar.log_out"), type="button", data_act="log-out", class_="plain")


def _stop(stops: str, replayed: bool) -> Markup:
    words = (
        tag("span", text_of("stop.button"), class_="stop-word"),
        tag("span", _coils(stops, replayed), class_="stop-key"),
    )
    return tag(
        "button", _ICON, *words,
        type="button", class_="stop", data_act="stop", data_board=stops, aria_keyshortcuts="Escape",
    )  # fmt: skip


def _coils(stops: str, replayed: bool) -> str:
    if stops != "*":
        return stops
    return text_of("stop.all_live_rigs") if replayed else text_of("stop.all_rigs")


def _what_stops(stops: str, replayed: bool) -> str:
    if stops != "*":
        return text_of("stop.scope_one", rig=stops)
    return text_of("stop.scope_all", rigs=_coils(stops, replayed))


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
        tag("div", tag("div", text_of(key), class_="number-title"),
            tag("div", _live(name), tag("span", unit, class_="unit"), class_="number-value"),
            class_="number big" if big else "number")
        for name, key, unit, big in _NUMBERS
    ]  # fmt: skip
    ball = (_live("ball", "div", class_="ball-drawing"), tag("div", *numbers, class_="numbers"))
    plots = [_live(name, "div", class_=f"plot {name}") for name in ("plot-x", "plot-i", "plot-d")]
    spans = [tag("button", text, type="button", class_="span-of", data_span=s) for s, text in texts_of("span").items()]
    bar = tag("div", tag("span", text_of("plots.span"), class_="hint"), *spans,
              tag("button", text_of("plots.pause"), type="button", class_="span-of", data_pause="yes"),
              tag("span", text_of("plots.hint"), class_="hint"), class_="plot-bar")  # fmt: skip
    return join(
        tag("div", *ball, _live("flags", "div", class_="flags"), class_="ball-card card"),
        tag("div", bar, *plots, class_="plots card"),
    )


def _list(title: str, name: str) -> Markup:
    entries = _live(name, "div", class_="entries", tabindex="0", role="group", aria_label=title)
    return tag("section", tag("h2", title, class_="card-title"), entries, class_=f"card list {name}")


def _to_model(board: str, reports: list[LibraryFile]) -> Markup:
    links = [tag("a", text_of("rig.to_model"), href=f"/model/{board}")]
    for entry in reports[:1]:
        links.append(tag("a", text_of("rig.last_report", date=entry.changed), href=f"/report/{entry.name}"))
    lines = [tag("div", link) for link in links]
    return _card(text_of("rig.model"), _live("wrong", "div", class_="wrong"), *lines, empty="")


def _report_row(entry: LibraryFile) -> Markup:
    rig = rig_of(entry)
    if rig:
        title = text_of("library.report", rig=rig, campaign=entry.path.parent.parent.name)
    else:
        title = f"{entry.path.parent.name}/{entry.path.name}"
    link = tag("a", title, href=f"/report/{entry.name}")
    return tag("div", link, tag("span", entry.changed, class_="at"), class_="file")


def _filter() -> Markup:
    hint = text_of("library.filter_hint")
    field = tag("input", type="text", data_filter="log", autocomplete="off", placeholder=hint)
    return tag("label", tag("span", text_of("library.filter")), field, class_="field")


def _log_row(entry: LibraryFile, *, deletable: bool) -> Markup:
    def button(text: str, act: str) -> Markup:
        return tag("button", text, type="button", class_="plain", data_act=act, data_log=entry.name)

    acts = (
        button(text_of("library.summary"), "summary"),
        controls.job(text_of("library.replay"), "replay", "start", log=entry.name, then="/replay/"),
        tag("a", text_of("library.download"), href=f"/log/{entry.name}"),
        button(text_of("library.delete"), "delete") if deletable and not entry.name.startswith("campaigns/") else "",
    )
    size = text_of("library.size", date=entry.changed, megabytes=f"{entry.bytes / 1e6:.1f}")
    return tag("div", tag("span", entry.name, class_="file-name"), tag("span", size, class_="at"),
               tag("div", *acts, class_="file-acts"), class_="file log")  # fmt: skip
