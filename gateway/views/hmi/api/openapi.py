"""The description of the API in OpenAPI 3.1, made of the table of endpoints and the dataclasses that they name.

Rule: nothing is written here that the server does not read from the same place; only a WebSocket has no words in
      OpenAPI, so the stream stands there as the GET that it begins with.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from pydantic import TypeAdapter

from gateway.views.hmi.api import shapes
from gateway.views.hmi.api.resource import BINARY, CSV, JSON, SOFT, BodyKinds, Endpoint
from gateway.views.hmi.model.campaigns import RESULTS
from gateway.views.hmi.programs import VERSION
from protocol.checked import keys_of

_REF = "#/components/schemas/{model}"
Schemas = Mapping[tuple[str, Any], dict[str, Any]]
_PARTS = {
    "rig": "name of the rig",
    "model": "name of the model; may contain /",
    "log": "name of the log; may contain /",
    "result": f"one of {', '.join(RESULTS)}",
}
_SOFT = f"With the query {SOFT}=true every answer has status 200, for clients that hide the body of an error."
_TOKEN = {
    "type": "http",
    "scheme": "bearer",
    "description": "of `board51 security add-token`; not needed where the page has no login",
}
_ALL = {400: "a value or key is not valid", 401: "no valid token", 403: "from a page of another server, or the role"}


def document(endpoints: Sequence[Endpoint], *, release: str, has_users: bool) -> dict[str, Any]:
    """Return the description."""
    definitions, schemas = _schemas(endpoints)
    paths: dict[str, dict[str, Any]] = {}
    for endpoint in endpoints:
        paths.setdefault(endpoint.path, {})[endpoint.method.lower()] = _operation(endpoint, schemas)
    return {
        "openapi": "3.1.0",
        "info": {"title": "Board51", "version": release, "description": f"{inspect.getdoc(shapes)}\n\n{_SOFT}"},
        "servers": [{"url": VERSION}],
        "security": [{"token": []}] if has_users else [],
        "paths": paths,
        "components": {"securitySchemes": {"token": _TOKEN}, "schemas": definitions},
    }


def _schemas(endpoints: Iterable[Endpoint]) -> tuple[dict[str, Any], Schemas]:
    """Return the definitions of all types that endpoints name, and the schema of each by its way, "in" or "out"."""
    kinds: dict[tuple[str, Any], TypeAdapter[Any]] = {("out", shapes.Problem): TypeAdapter(shapes.Problem)}
    for endpoint in endpoints:
        for way, kind in (("out", endpoint.answer), ("in", endpoint.body)):
            if kind is not None:
                whole = kind.annotated if isinstance(kind, BodyKinds) else kind
                kinds.setdefault((way, kind), TypeAdapter(whole))
    made, defined = TypeAdapter.json_schemas(
        [(key, "serialization" if key[0] == "out" else "validation", adapter) for key, adapter in kinds.items()],
        ref_template=_REF,
    )
    return defined["$defs"], {key: schema for (key, _), schema in made.items()}


def _operation(endpoint: Endpoint, schemas: Schemas) -> dict[str, Any]:
    name = re.sub(r"[^a-z]+", "-", f"{endpoint.method} {endpoint.path}".lower()).strip("-")
    operation: dict[str, Any] = {
        "operationId": name,
        "summary": (inspect.getdoc(endpoint.run) or "").strip(),
        "tags": [endpoint.tag],
        "parameters": _parameters(endpoint),
        "responses": _responses(endpoint, schemas),
    }
    if endpoint.body is not None:
        body = {"schema": schemas["in", endpoint.body]}
        operation["requestBody"] = {"content": {JSON: body}}
    return operation


def _parameters(endpoint: Endpoint) -> list[dict[str, Any]]:
    parameters: list[dict[str, Any]] = [
        {"name": name, "in": "path", "required": True, "description": _PARTS[name], "schema": {"type": "string"}}
        for name in re.findall(r"{(\w+)}", endpoint.path)
    ]
    if endpoint.query is not None:
        defaults = {f.name: f.default for f in fields(endpoint.query)}
        for name, hint in keys_of(endpoint.query).items():
            schema = TypeAdapter(hint).json_schema()
            description = schema.pop("description", "")
            schema["default"] = defaults[name]
            parameters.append(
                {"name": name, "in": "query", "required": False, "description": description, "schema": schema}
            )
    return parameters


def _responses(endpoint: Endpoint, schemas: Schemas) -> dict[str, Any]:
    content = {
        JSON: {"schema": schemas["out", endpoint.answer] if endpoint.answer is not None else {}},
        CSV: {"schema": {"type": "string"}},
        BINARY: {"schema": {"type": "string", "format": "binary"}},
    }
    responses: dict[str, Any] = {
        "200": {"description": "done", "content": {media: content[media] for media in endpoint.media}}
    }
    error = schemas["out", shapes.Problem]
    if endpoint.answer is shapes.Reply:
        error = {"anyOf": [error, schemas["out", shapes.Reply]]}
    for status, words in (_ALL | dict(endpoint.statuses)).items():
        responses[str(status)] = {"description": words, "content": {JSON: {"schema": error}}}
    return responses
