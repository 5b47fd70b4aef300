"""Units of a channel that are not SI: as the name of a column tells them, or the size of its values suggests.  Pure.

Rule: a name is believed (`x_mm`, `i [mA]`, `t (ms)`), a size only makes one ask: a plausible number may still be wrong.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_METRES = {"mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6, "nm": 1e-9}
# What one of a unit is in the SI unit of the channel.
SCALES: Mapping[str, Mapping[str, float]] = {
    "t": {"ms": 1e-3, "us": 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6, "ns": 1e-9},
    "u_c": {"mv": 1e-3, "uv": 1e-6, "kv": 1e3},
    "i_c": {"ma": 1e-3, "ua": 1e-6, "ka": 1e3},
    "x": _METRES,
    "x_ref": _METRES,
}
# The largest that a laboratory rig of this kind has; of t, between two samples.
MOST: Mapping[str, float] = {"t": 0.2, "u_c": 400.0, "i_c": 30.0, "x": 0.5, "x_ref": 0.5}
# Beyond this it is no measurement at all: a marker for "no value", or a number of another kind.
NOT_MEASURED: Mapping[str, float] = {"t": 9e9, "u_c": 1e6, "i_c": 1e6, "x": 1e6, "x_ref": 1e6}
_UNIT = re.compile(r"(?:^|[_\s\[(/.])([^\W\d_]+)[\])]?\s*$")


def unit_of_name(column: str, channel: str) -> tuple[str, float] | None:
    """(unit, its SI value) that the name of a column ends with, where that is not the SI unit of the channel."""
    found = _UNIT.search(column)
    scale = SCALES[channel].get(found[1].lower()) if found is not None else None
    return None if found is None or scale is None else (found[1], scale)


def scale_of_size(largest: float, channel: str) -> float | None:
    """The power of 1000 that makes `largest` (of t: the step) plausible for the channel; None where it is."""
    if largest <= MOST[channel]:
        return None
    return next((scale for scale in (1e-3, 1e-6) if largest * scale <= MOST[channel]), 1e-9)
