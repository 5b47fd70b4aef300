"""The texts of the pages, from texts.toml.

Rule: a text is plain text.  `tag` escapes it together with its values, and the scripts set it as `textContent`.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

FILE = Path(__file__).parent / "texts.toml"


@cache
def _sections() -> dict[str, dict[str, str]]:
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def text_of(key: str, **values: object) -> str:
    """Return the text of `SECTION.NAME`, each {placeholder} replaced by its value.

    Raises:
        KeyError: there is no such text, or a value is missing.
    """
    section, _, name = key.partition(".")
    return _sections()[section][name].format_map(values)


def texts_of(section: str) -> Mapping[str, str]:
    """Return the texts of a section by their names, for names that come from data, such as the state of a link."""
    return _sections()[section]


@cache
def for_scripts() -> str:
    """Return all texts as JSON, by section and name; a page hands them to its scripts."""
    return json.dumps(_sections(), ensure_ascii=False, separators=(",", ":"))
