"""Docstrings of this repository state numbered rules; the API pages show them as a list.

Without this, `Rule 1: ...` with a second, indented line is read as a section of a Google docstring.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

_RULE = re.compile(r"^(Rule(?: \d+)?): (.*(?:\n[ \t]+\S.*)*)", re.MULTILINE)


class Rules(griffe.Extension):
    """Rewrites rules as list items before docstrings are parsed."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """See `griffe.Extension.on_object`."""
        if obj.docstring is not None:
            obj.docstring.value = _RULE.sub(_as_item, obj.docstring.value)


def _as_item(match: re.Match[str]) -> str:
    return f"- *{match[1]}.* {' '.join(match[2].split())}"
