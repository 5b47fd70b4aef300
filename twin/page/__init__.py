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
    ".wide{overflow-x:auto}.figures{display:flex;flex-wrap:wrap;gap:4px 16px;align-items:flex-start}"
    ".figures figure{margin:6px 0;flex:1 1 430px;max-width:540px;min-width:0}.figures img{width:100%}"
    "figcaption{font-size:13px;color:#555}"
    ".found{border-color:#1f77b4}.warn{border-left:6px solid #b8860b;background:#fdf6e3;padding:6px 14px}"
    ".card{border:1px solid #ccc;border-radius:6px;padding:4px 16px 10px;margin:14px 0}"
    ".card dt{font-weight:600;margin-top:8px}.card dd{margin:0}"
    "pre{background:#f5f5f5;padding:10px 14px;overflow-x:auto}summary{cursor:pointer;font-weight:600;margin:8px 0}"
    "td{white-space:nowrap}.words td{text-align:left;vertical-align:top;white-space:normal}.words th{text-align:left}"
    "@media(max-width:640px){body{margin:12px auto;padding:0 10px}.answer{font-size:17px}td,th{padding:3px 7px}}"
)
VIEWPORT = '<meta name="viewport" content="width=device-width,initial-scale=1">'


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


def table(head: Sequence[str], rows: Sequence[Sequence[str]], *, words: bool = False) -> str:
    """A table; cells are HTML.  `words`: cells are text that may break, aligned to the left."""
    cells = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    lines = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    kind = ' class="words"' if words else ""
    return f'<div class="wide"><table{kind}><tr>{cells}</tr>{lines}</table></div>'


def image(data: bytes, about: str) -> str:
    """A PNG, inside the page."""
    return f'<img alt="{html.escape(about)}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'


def drawing(data: bytes, caption: str) -> str:
    """An SVG with its caption, inside the page; several stand side by side in `figures`."""
    source = base64.b64encode(data).decode()
    text = html.escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/svg+xml;base64,{source}"><figcaption>{text}</figcaption></figure>'
    )


def figures(drawings: Sequence[str]) -> str:
    """As many beside each other as there is room for."""
    return f'<div class="figures">{"".join(drawings)}</div>' if drawings else ""


def folded(title: str, content: str) -> str:
    """Shown on request."""
    return f"<details><summary>{html.escape(title)}</summary>{content}</details>"


def whole(title: str, body: Sequence[str]) -> str:
    """The document."""
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8">{VIEWPORT}<title>{html.escape(title)}</title>'
        f"<style>{CSS}</style></head><body>{''.join(body)}</body></html>\n"
    )
