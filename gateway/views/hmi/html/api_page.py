"""The page of the API: the OpenAPI description as tables for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

Schema = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A key of a query, a body or an answer."""

    name: str
    kind: str  # in words
    text: str
    needed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """The keys of one object."""

    text: str
    rows: list[Row]


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """A method of a path."""

    method: str
    path: str
    text: str
    query: list[Row]
    bodies: list[Table]
    answer: Table | None


def operations(document: Schema) -> list[Operation]:
    """Return what the page shows of an OpenAPI document."""
    base, schemas = document["servers"][0]["url"], document["components"]["schemas"]
    shown = []
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            body = _content(operation.get("requestBody", {}))
            shown.append(
                Operation(
                    method=method.upper(),
                    path=base + path,
                    text=operation["summary"],
                    query=[_parameter(parameter) for parameter in operation["parameters"]],
                    bodies=list(_tables(body, schemas)),
                    answer=next(_tables(_content(operation["responses"]["200"]), schemas), None),
                )
            )
    return shown


def _content(holder: Schema) -> Schema:
    schema: Schema = holder.get("content", {}).get("application/json", {}).get("schema", {})
    return schema


def _parameter(parameter: Schema) -> Row:
    schema = parameter["schema"]
    return Row(name=parameter["name"], kind=_kind(schema), text=parameter["description"], needed=parameter["required"])


def _tables(schema: Schema, schemas: Schema) -> Iterator[Table]:
    for option in schema.get("oneOf", [schema]):
        whole = schemas[option["$ref"].rpartition("/")[2]] if "$ref" in option else option
        if "properties" not in whole:
            continue
        yield Table(text=whole.get("description", ""), rows=list(_rows(whole, schemas, "")))


def _rows(table: Schema, schemas: Schema, prefix: str) -> Iterator[Row]:
    """Yield the keys of an object, and after each that is an object, or a list of objects, those of it."""
    for name, part in table["properties"].items():
        options = [part, part.get("items", {}), *part.get("anyOf", [])]
        inner: Schema = next((schemas[option["$ref"].rpartition("/")[2]] for option in options if "$ref" in option), {})
        text = part.get("description") or inner.get("description", "")
        yield Row(name=prefix + name, kind=_kind(part), text=text, needed=name in table.get("required", []))
        if "properties" in inner:
            yield from _rows(inner, schemas, f"{prefix}{name}.")


def _kind(schema: Schema) -> str:
    """Return a schema in a few words: the values that it allows, else its type."""
    if "const" in schema:
        return f'"{schema["const"]}"'
    if "enum" in schema:
        return " | ".join(f'"{value}"' for value in schema["enum"])
    if "$ref" in schema:
        return "object"
    if "anyOf" in schema:
        return " | ".join(_kind(option) for option in schema["anyOf"])
    kind = str(schema.get("type", ""))
    if kind == "array":
        return f"[{_kind(schema.get('items', {}))}]"
    ends = [f"{schema[end]:g}" for end in ("minimum", "maximum") if end in schema]
    return f"{kind} {' .. '.join(ends)}" if len(ends) == 2 else kind
