"""The routes of the API."""

from __future__ import annotations

import re
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts
from gateway.views.hmi.api.endpoints import Endpoints
from gateway.views.hmi.api.job_endpoints import WorkEndpoints
from gateway.views.hmi.api.openapi import document
from gateway.views.hmi.api.resource import Endpoint, Resource
from gateway.views.hmi.api.stream import Streams
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.problems import problem
from gateway.views.hmi.programs import VERSION

_DEEP = re.compile(r"{(model|log)}")  # names that may contain a slash


class Api:
    """The API of one server."""

    def __init__(self, actions: Actions, acts: Acts, work: ModelWork) -> None:
        self._has_users = actions.sessions.users is not None
        self._streams = Streams(actions.feed, actions.sessions)
        self._endpoints = [*Endpoints(actions, acts).table(), *WorkEndpoints(actions, acts, work).table()]

    @cached_property
    def document(self) -> dict[str, Any]:
        """Return the description in OpenAPI."""
        return document(self._endpoints, release=release(), has_users=self._has_users)

    def routes(self) -> list[BaseRoute]:
        """Return the routes."""
        paths: dict[str, list[Endpoint]] = {}
        for endpoint in self._endpoints:
            paths.setdefault(endpoint.path, []).append(endpoint)

        async def openapi(_: Request) -> Response:
            return JSONResponse(self.document)

        return [
            WebSocketRoute(f"{VERSION}/rigs/{{rig}}/stream", self._streams.samples),
            WebSocketRoute(f"{VERSION}/rigs/{{rig}}/events/stream", self._streams.events),
            Route(f"{VERSION}/openapi.json", openapi),
            *(Route(VERSION + _DEEP.sub(r"{\1:path}", path), Resource(endpoints)) for path, endpoints in paths.items()),
        ]


async def not_there(request: Request, error: Exception) -> Response:
    """Answer for a path that no route has: in the form of the API where it begins as that does."""
    path = request.url.path
    if path.startswith(f"{VERSION}/"):
        return problem(404, "no-path", f"There is no {path[:200]}")
    return PlainTextResponse("Not Found", 404)


def release() -> str:
    """Return the version of this software."""
    try:
        return version("board51")
    except PackageNotFoundError:
        return "unknown"
