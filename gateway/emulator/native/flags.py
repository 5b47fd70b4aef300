"""The compilers' flags of each target, from `firmware/flags.mk`, which `firmware/Makefile` includes."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[3] / "firmware"  # beside the packages, in the repository as in a wheel


def flags(*names: str) -> tuple[str, ...]:
    """Return the words of these lines, in the order of the names."""
    return tuple(word for name in names for word in _lines()[name].split())


@cache
def _lines() -> dict[str, str]:
    text = (SOURCES / "flags.mk").read_text(encoding="utf-8")
    return dict(re.findall(r"^(\w+) = (.*)$", text, re.MULTILINE))
