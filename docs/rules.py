"""What the API pages show beyond docstrings: numbered rules as a list, and the members of enumerations and dataclasses.

Without this, `Rule 1: ...` with a second, indented line is read as a section of a Google docstring. Enumerations and
dataclasses would be names without what their members mean: these have comments, not docstrings.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import griffe

_ENUMERATIONS = {"Enum", "IntEnum", "IntFlag", "StrEnum"}
_COMMENT = re.compile(r"  # (.*)$")
_RULE = re.compile(r"^(Rule(?: \d+)?): (.*(?:\n[ \t]+\S.*)*)", re.MULTILINE)


class Rules(griffe.Extension):
    """Rewrites rules as list items, and lists members, before docstrings are parsed."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """See `griffe.Extension.on_object`."""
        if obj.docstring is not None:
            obj.docstring.value = _RULE.sub(_as_item, obj.docstring.value)
            if isinstance(obj, griffe.Class):
                is_enumeration = _ENUMERATIONS & {str(base).rpartition(".")[2] for base in obj.bases}
                members = _members(obj) if is_enumeration else _fields(obj) if _is_dataclass(obj) else ()
                obj.docstring.value += "\n\n" + "\n".join(members)


def _members(enumeration: griffe.Class) -> Iterator[str]:
    """Each member with its value and the comment on its line."""
    for name, member in enumeration.attributes.items():
        if not name.startswith("_"):
            comment = _COMMENT.search(member.source)
            yield f"- `{name} = {member.value}`" + (f": {comment[1]}" if comment else "")


def _fields(dataclass: griffe.Class) -> Iterator[str]:
    """Each field that has a comment on its line; the signature has all of them with their types."""
    for name, field in dataclass.attributes.items():
        comment = _COMMENT.search(field.source.partition("\n")[0])
        if comment and not name.startswith("_"):
            yield f"- `{name}`: {comment[1]}"


def _is_dataclass(kind: griffe.Class) -> bool:
    return any(str(decorator.value).startswith("dataclass") for decorator in kind.decorators)


def _as_item(match: re.Match[str]) -> str:
    return f"- *{match[1]}.* {' '.join(match[2].split())}"
