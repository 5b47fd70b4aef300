"""Renders pages from the templates of this folder.

Rule: whatever a template shows is escaped, so nothing from the bus, a file's name or a log becomes HTML.  A value that
it misses is an error.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.responses import HTMLResponse

from gateway.views.hmi.texts import for_scripts, text_of, texts_of

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    auto_reload=False,  # pages and code are of one version
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals |= {"text_of": text_of, "texts_of": texts_of, "json": json.dumps, "all_texts": for_scripts()}
_TEMPLATES.globals["zone"] = lambda: time.strftime("%Z (UTC%z)")  # of this server
_TEMPLATES.globals["parts"] = _TEMPLATES.get_template("parts.html").module
for _name in _TEMPLATES.list_templates(extensions=["html"]):  # now: the first visitor's page would hold up a STOP
    _TEMPLATES.get_template(_name)
_INDENT = re.compile(r">\s+<")  # a browser would show it as a blank


def render(template: str, values: Mapping[str, object], *, status: int = 200) -> HTMLResponse:
    """Return a page; a browser asks for it again each time."""
    text = _INDENT.sub("><", _TEMPLATES.get_template(template).render(values))
    return HTMLResponse(text, status_code=status, headers={"cache-control": "no-store"})
