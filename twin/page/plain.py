"""Results as plain values for a JSON file, and as columns of text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin.page.render import Mark


def plain(table: Mapping[str, object], digits: int = 17) -> dict[str, Any]:
    """The table with lists for arrays, and numbers of so many digits; None for one that is not finite."""
    return {key: _plain(value, digits) for key, value in table.items()}


def _plain(value: object, digits: int) -> object:
    if isinstance(value, dict):
        return plain(value, digits)
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(entry, digits) for entry in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value


def micrometres(value_m: float) -> str:
    """Write a length in micrometres with three digits, never with an exponent."""
    value = value_m * 1e6
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def columns(rows: Sequence[Sequence[str | Mark]]) -> list[str]:
    """Return a line of text for each row, its cells below one another."""
    cells = [[cell if isinstance(cell, str) else cell.text for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in cells]
