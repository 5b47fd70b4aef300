"""The routes of the API."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts
from gateway.views.hmi.api.endpoints import Endpoints
from gateway.views.hmi.api.openapi import document
from gateway.views.hmi.api.recent import Recent
from gateway.views.hmi.api.resource import Endpoint, Resource
from gateway.views.hmi.api.stream import Streams
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.problems import problem
from gateway.views.hmi.programs import VERSION

_DEEP = re.compile(r"{(model|log)}")  # names that may contain a slash


class Api:
    """The API of one server.

    Args:
        actions: checks rights, and acts.
        acts: runs acts.
        work: on models.
    """

    def __init__(self, actions: Actions, acts: Acts, work: ModelWork) -> None:
        self.recent = Recent(actions.feed)
        self._streams = Streams(actions.feed, actions.sessions)
        self._endpoints = Endpoints(actions, acts, work, self.recent).table()

    @cached_property
    def document(self) -> dict[str, Any]:
        """Return the description in OpenAPI."""
        return document(self._endpoints, release=release())

    def routes(self) -> list[BaseRoute]:
        """Return the routes, without the one for all other paths."""
        paths: dict[str, list[Endpoint]] = {}
        for endpoint in self._endpoints:
            paths.setdefault(endpoint.path, []).append(endpoint)

        async def openapi(_: Request) -> Response:
            return JSONResponse(self.document)

        return [
            WebSocketRoute(f"{VERSION}/rigs/{{rig}}/stream", self._streams.stream),
            Route(f"{VERSION}/openapi.json", openapi),
            *(Route(VERSION + _DEEP.sub(r"{\1:path}", path), Resource(endpoints)) for path, endpoints in paths.items()),
        ]

    @staticmethod
    def no_path() -> Route:
        """Return the route of all other paths; below the page's own, as a rig may be called v1."""
        return Route(f"{VERSION}/{{rest:path}}", _no_path, methods=_METHODS)


_METHODS: Sequence[str] = ("GET", "POST", "PUT", "PATCH", "DELETE")


async def _no_path(request: Request) -> Response:
    return problem(404, "no-path", f"There is no {request.url.path[:200]}")


def release() -> str:
    """Return the version of this software."""
    try:
        return version("board51")
    except PackageNotFoundError:
        return "unknown"
