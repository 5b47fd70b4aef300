"""Reports from templates: the `.html` files of `twin`, each beside the code that gives it its values.

Rule: whatever a template shows is escaped, and a value that it misses is an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parents[1]),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals["parts"] = _TEMPLATES.get_template("page/parts.html").module


@dataclass(frozen=True, slots=True)
class Mark:
    """A word that a table shows green or red."""

    text: str
    good: bool


def yes_or_no(good: bool) -> Mark:
    """Return a green "yes" or a red "no"."""
    return Mark("yes" if good else "no", good)


def render(template: str, /, **values: object) -> str:
    """The page.

    Args:
        template: its path under `twin/`; it extends `page/base.html` and has the macros of `page/parts.html`.
        values: the variables of the template.
    """
    return _TEMPLATES.get_template(template).render(values) + "\n"
