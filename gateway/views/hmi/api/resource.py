"""The answer of one path of the API: reads a request, runs its endpoint, writes JSON.

Rule 1: every answer is an endpoint's or {"code", "message", "remedy"}; never a traceback.
Rule 2: an unknown key is an error, in the query and in the body: a misspelt one would be left out in silence.
Rule 3: a body is JSON, or a form as HTML has it: MATLAB and Octave send forms, and curl -d sends JSON as one.
Rule 4: with ?soft_errors=true the status is 200 whatever became of it, for clients that hide the body of an error.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cache
from typing import Annotated, Any, Union
from urllib.parse import parse_qsl

from pydantic import Field, TypeAdapter
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from gateway.views.hmi.api.shapes import Reply
from gateway.views.hmi.problems import problem
from gateway.views.hmi.refusals import RefusalError
from protocol.checked import checked, keys_of, plain_of
from protocol.errors import Board51Error, DataError
from protocol.files import parse_json

SOFT = "soft_errors"
JSON, CSV, BINARY = "application/json", "text/csv", "application/octet-stream"
_UNDONE = {"executed": False, "refused_by": "hmi", "tick": 0}
_FORM = "application/x-www-form-urlencoded"
_logger = logging.getLogger("gateway.hmi")


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A request whose query and body have been checked."""

    request: Request
    query: Any  # of the endpoint's class
    body: Any

    def path(self, name: str) -> str:
        """Return a part of the path."""
        return str(self.request.path_params[name])


@dataclass(frozen=True, slots=True, eq=False)
class BodyKinds:
    """Bodies of several types, which one key tells apart."""

    key: str
    kinds: Mapping[str, type]  # by the value of the key

    def kind(self, table: Mapping[str, object]) -> type:
        """Return the type of a body.

        Raises:
            RefusalError: the key is absent or has another value.
        """
        word = table.get(self.key)
        kind = self.kinds.get(str(word))
        if kind is None:
            what = f"{self.key} is missing" if word is None else f"{self.key} is {str(word)[:40]!r}"
            raise RefusalError("malformed", what, status=400, remedy=f"Give one of {', '.join(self.kinds)}")
        return kind

    @property
    def annotated(self) -> Any:
        """Return the type of them all, for the description."""
        return Annotated[Union[tuple(self.kinds.values())], Field(discriminator=self.key)]  # noqa: UP007  # a union of a tuple


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A method of a path; its description is that of `run`."""

    method: str
    path: str
    run: Callable[[Call], Awaitable[object]]  # returns a value of `answer`, or a response
    answer: Any  # dataclass or annotated type; None: bytes
    tag: str
    _: KW_ONLY
    query: type | None = None
    body: type | BodyKinds | None = None
    media: tuple[str, ...] = (JSON,)
    statuses: Mapping[int, str] = field(default_factory=dict)  # beside 200 and those that every endpoint has
    unchecked: bool = False  # act whatever query and body are: STOP


class Resource:
    """The ASGI application of one path."""

    def __init__(self, endpoints: Sequence[Endpoint]) -> None:
        self._endpoints = {endpoint.method: endpoint for endpoint in endpoints}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        request = Request(scope, receive)
        response = await self._answer(request)
        if response.status_code >= 400 and request.query_params.get(SOFT) == "true":
            response.status_code = 200
        await response(scope, receive, send)

    async def _answer(self, request: Request) -> Response:
        endpoint = self._endpoints.get("GET" if request.method == "HEAD" else request.method)
        if endpoint is None:
            allowed = ", ".join(self._endpoints)
            answer = problem(405, "method", f"{request.method[:16]} is not possible here, only {allowed}")
            answer.headers["allow"] = allowed
            return answer
        # Each answer to a command has `executed`, whoever refuses the command: clients rely on it.
        more: dict[str, Any] = _UNDONE if endpoint.answer is Reply else {}
        try:
            return await _run(endpoint, request)
        except RefusalError as error:
            return problem(error.status, error.reply.reason, error.reply.text, remedy=error.remedy, **more)
        except Board51Error as error:
            return problem(400, "malformed", error.problem, remedy=error.remedy, **more)
        except ClientDisconnect:
            raise
        except Exception:  # Rule 1
            _logger.exception("%s %s failed", request.method, request.url.path)
            return problem(500, "internal", "An internal error of this server; its output has the details", **more)


async def _run(endpoint: Endpoint, request: Request) -> Response:
    query = body = None
    if not endpoint.unchecked:
        pairs = [(name, value) for name, value in request.query_params.multi_items() if name != SOFT]
        query = checked_form(endpoint.query, pairs, where="query")
        if endpoint.body is not None:
            table, is_form = await _table(request)
            kind = endpoint.body.kind(table) if isinstance(endpoint.body, BodyKinds) else endpoint.body
            if is_form:
                body = checked_form(kind, [(name, str(text)) for name, text in table.items()], where="body")
            else:
                body = checked(kind, dict(table), where="body", error=DataError)
    answer = await endpoint.run(Call(request=request, query=query, body=body))
    if isinstance(answer, Response):
        return answer
    return Response(_adapter(endpoint.answer).dump_json(answer), media_type=JSON)


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def checked_form(kind: type | None, pairs: Sequence[tuple[str, str]], *, where: str) -> Any:
    """Return the values of a query or form as `kind`; a text that stands for a number is one.

    Raises:
        DataError: a key is unknown, appears twice, or its value is not valid.
    """
    keys = keys_of(kind) if kind is not None else {}
    table: dict[str, object] = {}
    for name, text in pairs:
        if name in table:
            raise DataError(f"{where}: {name} appears twice", remedy="Give it once")
        table[name] = text if name not in keys or plain_of(keys[name]) is str else _value(text)
    if kind is None:
        if table:
            raise DataError(f"{where}: {next(iter(table))} is not a key", remedy="Leave it out: there are none")
        return None
    return checked(kind, table, where=where, error=DataError)


def _value(text: str) -> object:
    """Return the number, truth value or list that a text of a form stands for; the text itself where it is none."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


async def _table(request: Request) -> tuple[Mapping[str, object], bool]:
    """Return the keys of a body, and whether it is a form."""
    data = await request.body()
    media = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    try:
        text = data.decode("utf-8").strip()
    except UnicodeDecodeError:
        raise RefusalError("malformed", "The body is not UTF-8 text", status=400) from None
    if not text:
        return {}, False
    if media not in ("", JSON, _FORM):
        raise RefusalError("media-type", f"The body is {media[:80]}", status=415)
    if media in ("", _FORM) and not text.startswith(("{", "[")):
        pairs = parse_qsl(text, keep_blank_values=True)
        if len(dict(pairs)) < len(pairs):
            raise RefusalError("malformed", "A key of the form appears twice", status=400)
        return dict(pairs), True
    try:
        table = parse_json(text, where="body")
    except Board51Error as error:
        raise RefusalError("malformed", error.problem, status=400) from None
    if not isinstance(table, dict):
        raise RefusalError("malformed", "The body is not a JSON object", status=400)
    return table, False
