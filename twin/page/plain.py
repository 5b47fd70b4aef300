"""Results as plain values for a JSON file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


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
