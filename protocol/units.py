"""Units of columns and of numbers on the command line: by the name of the column, a suffix, or the size.  Pure.

Rule: a unit in the name is decisive (`x_mm`, `i [mA]`, `t (ms)`); an implausible size only gives a warning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from protocol.errors import UsageError

UNITS: Mapping[str, str] = {"t": "s", "u_c": "V", "i_c": "A", "x": "m", "x_ref": "m"}
_METRES = {"mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6, "nm": 1e-9}
# Value of one unit in the SI unit of the channel.
SCALES: Mapping[str, Mapping[str, float]] = {
    "t": {"ms": 1e-3, "us": 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6, "ns": 1e-9},
    "u_c": {"mv": 1e-3, "uv": 1e-6, "kv": 1e3},
    "i_c": {"ma": 1e-3, "ua": 1e-6, "ka": 1e3},
    "x": _METRES,
    "x_ref": _METRES,
}
# Largest plausible value of a laboratory rig; for t, the largest time between two samples.
MAX_PLAUSIBLE: Mapping[str, float] = {"t": 0.2, "u_c": 400.0, "i_c": 30.0, "x": 0.5, "x_ref": 0.5}
# A value beyond this is not a measurement: it is a marker for "no value", or another kind of number.
NOT_MEASURED: Mapping[str, float] = {"t": 9e9, "u_c": 1e6, "i_c": 1e6, "x": 1e6, "x_ref": 1e6}
_UNIT = re.compile(r"(?:^|[_\s\[(/.])([^\W\d_]+)[\])]?\s*$")

_SUFFIX = re.compile(r"(.*?)\s*([^\W\d_]*)", re.DOTALL)


def unit_of_name(column: str, channel: str) -> tuple[str, float] | None:
    """Return (unit, its SI value) if the name of a column ends with a unit other than the channel's SI unit."""
    match = _UNIT.search(column)
    scale = SCALES[channel].get(match[1].lower()) if match is not None else None
    return None if match is None or scale is None else (match[1], scale)


def scale_of_size(largest: float, channel: str) -> float | None:
    """Return the power of 1000 that makes `largest` (for t: the step) plausible; None if it is plausible already."""
    if largest <= MAX_PLAUSIBLE[channel]:
        return None
    return next((scale for scale in (1e-3, 1e-6) if largest * scale <= MAX_PLAUSIBLE[channel]), 1e-9)


def quantity(text: str, channel: str) -> float:
    """Return the value of a channel in its SI unit, from a number in it (`0.003`) or with a unit (`3mm`).

    Raises:
        UsageError: it is not a finite number, or larger than on any rig; then the message suggests the likely unit.
    """
    si = UNITS[channel]
    digits, unit = _SUFFIX.fullmatch(text).groups()  # type: ignore[union-attr]  # it matches any line
    scale = 1.0 if unit in ("", si) else SCALES[channel].get(unit.lower())
    try:
        value = float(text if scale is None else digits) * (scale or 1.0)
    except ValueError:
        raise UsageError(f"{text!r} is not a number", remedy=f"Give it in {si}, or with its unit: 3m{si}") from None
    if not math.isfinite(value):
        raise UsageError(f"{text!r} is not a finite number", remedy=f"Give it in {si}")
    smaller = scale_of_size(abs(value), channel)
    if smaller is not None:
        prefix = {1e-3: "m", 1e-6: "\u00b5", 1e-9: "n"}[smaller]
        raise UsageError(
            f"{value:g} {si} is more than any such rig has",
            remedy=f"You may mean {value * smaller:g} ({value:g} {prefix}{si})",
        )
    return value
