"""Pieces of HTML of which the report is put together; text is escaped here."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

CSS = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1120px;margin:24px auto;padding:0 16px;color:#222}"
    ".answer{font-size:19px;border-left:6px solid #888;padding:8px 14px;background:#f5f5f5}"
    ".pass{border-color:#2a7f3f}.fail{border-color:#c0392b}"
    "table{border-collapse:collapse;margin:10px 0}td,th{padding:3px 12px;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
    ".no{color:#c0392b;font-weight:600}.yes{color:#2a7f3f}.untested{color:#777;font-style:italic}"
)


def untested(reason: str) -> str:
    """Why a part is not testable."""
    return f'<p class="untested">Not testable: {html.escape(reason)}.</p>'


def mark(good: bool) -> str:
    """Yes or no."""
    return "<span class=yes>yes</span>" if good else "<span class=no>no</span>"


def paragraph(text: str) -> str:
    """Text as a paragraph."""
    return f"<p>{html.escape(text)}</p>"


def bullets(lines: Sequence[str]) -> str:
    """Lines as a list."""
    return "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in lines) + "</ul>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; cells are HTML."""
    cells = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    lines = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{lines}</table>"


def image(data: bytes, about: str) -> str:
    """A PNG, inside the page."""
    return f'<img alt="{html.escape(about)}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
