"""What the API pages show beyond docstrings: numbered rules as a list, and the members of enumerations.

Without this, `Rule 1: ...` with a second, indented line is read as a section of a Google docstring, and an enumeration
is a name without its members: they have comments, not docstrings.
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
            if isinstance(obj, griffe.Class) and _ENUMERATIONS & {str(base).rpartition(".")[2] for base in obj.bases}:
                obj.docstring.value += "\n\n" + "\n".join(_members(obj))


def _members(enumeration: griffe.Class) -> Iterator[str]:
    """Each member with its value and the comment on its line."""
    for name, member in enumeration.attributes.items():
        if not name.startswith("_"):
            comment = _COMMENT.search(member.source)
            yield f"- `{name} = {member.value}`" + (f": {comment[1]}" if comment else "")


def _as_item(match: re.Match[str]) -> str:
    return f"- *{match[1]}.* {' '.join(match[2].split())}"
