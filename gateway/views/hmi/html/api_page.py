"""The page of the API: the OpenAPI description as tables for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

Schema = Mapping[str, Any]


class Row(NamedTuple):
    """A key of a query, a body or an answer."""

    name: str
    kind: str  # in words
    text: str
    needed: bool


def operations(document: Schema) -> Iterator[dict[str, Any]]:
    """Yield what the page shows of each operation of an OpenAPI document."""
    base, schemas = document["servers"][0]["url"], document["components"]["schemas"]
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield {
                "name": f"{method.upper()} {base}{path}",
                "text": operation["summary"],
                "query": [
                    Row(part["name"], _kind(part["schema"]), part["description"], part["required"])
                    for part in operation["parameters"]
                ],
                "bodies": list(_tables(operation.get("requestBody", {}), schemas)),
                "answers": list(_tables(operation["responses"]["200"], schemas)),
            }


def _tables(holder: Schema, schemas: Schema) -> Iterator[tuple[str, list[Row]]]:
    """Yield description and keys of each object that a body may be."""
    schema = holder.get("content", {}).get("application/json", {}).get("schema", {})
    for option in schema.get("oneOf", [schema]):
        whole = schemas[option["$ref"].rpartition("/")[2]] if "$ref" in option else option
        if "properties" in whole:
            yield whole.get("description", ""), list(_rows(whole, schemas, ""))


def _rows(table: Schema, schemas: Schema, prefix: str) -> Iterator[Row]:
    """Yield the keys of an object, and after each that is an object, or a list of objects, those of it."""
    for name, part in table["properties"].items():
        options = [part, part.get("items", {}), *part.get("anyOf", [])]
        inner: Schema = next((schemas[option["$ref"].rpartition("/")[2]] for option in options if "$ref" in option), {})
        text = part.get("description") or inner.get("description", "")
        yield Row(prefix + name, _kind(part), text, name in table.get("required", []))
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
