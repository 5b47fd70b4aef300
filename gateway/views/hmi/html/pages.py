"""The pages: overview, rig, replay, logs, report.  What moves is drawn by static/hmi.js; here stand frames and words.

Rule 1: a control that the session may not use is not on its page; `actions.py` refuses it as well.
Rule 2: a page has no state in the server: each act is a separate request, so it works after any interruption.
Rule 3: every page has STOP and the key Esc: for its rig, or, where it belongs to none, for all rigs of the site.
Rule 4: elements that come and go have a reserved place: nothing may push a button away from under a finger.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from gateway.access.roles import MINIMUM_ROLE
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.guard import session_of
from gateway.views.hmi.html.api_page import operations
from gateway.views.hmi.html.model_page import shown
from gateway.views.hmi.html.render import render
from gateway.views.hmi.model.campaigns import campaign_of, rig_of
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.programs import VERSION
from gateway.views.hmi.texts import text_of

REPLAY = "/live-replay"  # where the frames of replays come from
MAX_REPORTS = 20


class Pages:
    """The pages of one server."""

    def __init__(self, actions: Actions, work: ModelWork, api: Mapping[str, Any]) -> None:
        self._actions, self._work, self._api = actions, work, api

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
            f"{VERSION}/": self.api,
        }
        return [Route(path, endpoint, methods=["GET"]) for path, endpoint in pages.items()]

    async def overview(self, request: Request) -> Response:
        """Return the page of all rigs."""
        return self._page(request, "overview.html", live="/live", title=text_of("title.overview"), prefix="/rig")

    async def rig(self, request: Request) -> Response:
        """Return the page of one rig, with the controls that this session may use."""
        board = request.path_params["board"]
        reports = [entry for entry in await asyncio.to_thread(self._actions.reports.entries) if rig_of(entry) == board]
        return self._page(
            request, "rig.html", live=f"/live/{board}", title=board, board=board, chips=True, script="spectrum.js",
            reports=reports[:1],
        )  # fmt: skip

    async def model(self, request: Request) -> Response:
        """Return the page of a rig's model: from a campaign to an extended model."""
        return await asyncio.to_thread(self._model, request)

    def _model(self, request: Request) -> Response:
        board, campaign = request.path_params["board"], request.query_params.get("campaign", "")
        values = shown(self._work, self._actions.reports, board, campaign)
        title = text_of("title.model", rig=board)
        return self._page(request, "model.html", live=f"/live/{board}", title=title, board=board, chips=True, **values)

    async def replays(self, request: Request) -> Response:
        """Return the page of all replayed rigs."""
        return self._page(request, "overview.html", live=REPLAY, title=text_of("title.replay"), prefix="/replay")

    async def replay(self, request: Request) -> Response:
        """Return the page of one rig of a recording."""
        board = request.path_params["board"]
        title = text_of("title.replay_of", rig=board)
        return self._page(
            request, "replay.html", live=f"{REPLAY}/{board}", title=title, board=board, chips=True, script="spectrum.js"
        )

    async def logs(self, request: Request) -> Response:
        """Return the page of reports and logs."""
        logs = await asyncio.to_thread(self._actions.logs.entries)
        reports = (await asyncio.to_thread(self._actions.reports.entries))[:MAX_REPORTS]
        folder, title = self._actions.reports.folders[0], text_of("title.library")
        return self._page(
            request, "library.html", live="/live", title=title, logs=logs, reports=reports, folder=folder,
            rig_of=rig_of, campaign_of=campaign_of,
        )  # fmt: skip

    async def api(self, request: Request) -> Response:
        """Return the list of what programs may ask."""
        return self._page(
            request, "api.html", live="/live", title=text_of("title.api"), operations=operations(self._api)
        )

    async def report(self, request: Request) -> Response:
        """Return a report within a page that has STOP; the report itself runs no script."""
        entry = await asyncio.to_thread(self._actions.report, request.path_params["name"])
        rig, live, title = rig_of(entry), "/live", text_of("title.report", date=entry.changed)
        if self._actions.feed.board(rig) is None:  # of a rig that is not here: its STOP would stop nothing
            rig = ""
        else:
            live, title = f"/live/{rig}", text_of("title.report_of", rig=rig, date=entry.changed)
        return self._page(request, "report.html", live=live, title=title, board=rig, report=entry)

    def _page(self, request: Request, template: str, *, live: str, **values: object) -> Response:
        """Return a page; `live` is where its frames come from, `board` the rig to which it belongs, if any."""
        session, sessions = session_of(request), self._actions.sessions

        def may(act: str) -> bool:
            return self._actions.may(session, act)

        common: dict[str, object] = {
            "board": "", "prefix": "", "chips": False, "script": "", "live": live, "replayed": live.startswith(REPLAY),
            "replay": self._actions.jobs.get("replay", "*"), "session": session, "role": sessions.role(session),
            "may": may, "rights": " ".join(filter(may, MINIMUM_ROLE)), "log_out": sessions.users is not None,
            "now_s": time.monotonic(),
        }  # fmt: skip
        return render(template, common | values)
