"""One value of a model file at a time: what it must be, or a DataError that names it."""

from __future__ import annotations

import math
from typing import Any, NoReturn

from protocol.errors import DataError


def table(data: object, where: str, name: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """`data` as an object that has `keys`."""
    if not isinstance(data, dict):
        refuse(where, f"{name} is {type(data).__name__}, not an object", "Compare with twin/model/ce152.json")
    for key in keys:
        if key not in data:
            refuse(where, f"{name} lacks {key!r}", "Add it, or start from a copy of twin/model/ce152.json")
    return data


def finite(value: object, where: str, key: str) -> float:
    """`value` as a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        refuse(where, f"{key} is {value!r}", "Give a finite number")
    return float(value)


def number(value: object, where: str, key: str, lowest: float, highest: float) -> float:
    """`value` as a number within lowest .. highest."""
    found = finite(value, where, key)
    if not lowest <= found <= highest:
        refuse(where, f"{key} = {found:g} is outside {lowest:g} .. {highest:g}", "Check the unit and the power of ten")
    return found


def refuse(where: str, problem: str, remedy: str) -> NoReturn:
    """Raise the DataError of the file `where`."""
    raise DataError(f"{where}: {problem}", remedy=remedy)
