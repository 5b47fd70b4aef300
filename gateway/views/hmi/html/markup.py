"""HTML made of elements.  Pure.

Rule: text is escaped unless `tag` made it, so nothing from the bus, a file's name or a log becomes HTML.
"""

from __future__ import annotations

import html

_VOID = frozenset({"input", "link", "meta"})  # elements without content


class Markup(str):
    """HTML, escaped where it had to be."""

    __slots__ = ()


def tag(name: str, /, *children: str, **attributes: str | float | None) -> Markup:
    """Return one element.

    Args:
        name: of the element.
        children: markup as it is, other text escaped.
        attributes: `class_` is class, `data_act` is data-act; True stands alone, None and False are left out.
    """
    words = "".join(_attribute(key, value) for key, value in attributes.items())
    if name in _VOID:
        return Markup(f"<{name}{words}>")
    return Markup(f"<{name}{words}>{join(*children)}</{name}>")


def join(*parts: str) -> Markup:
    """Return the pieces of markup, one after the other."""
    return Markup("".join(part if isinstance(part, Markup) else html.escape(part) for part in parts))


def _attribute(key: str, value: str | float | None) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{html.escape(str(value), quote=True)}"'
