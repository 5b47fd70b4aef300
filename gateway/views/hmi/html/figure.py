"""The prediction error before and after a diagnosis, as a picture: error over horizon, both axes logarithmic.  Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from protocol.diagnosis import Ahead, Interval

_MIN_ERROR_M = 1e-9  # an error of 0 has no logarithm


def errors_figure(ahead: Sequence[Ahead]) -> dict[str, Any] | None:
    """Return the picture of the rms error of x on the judge recordings; None where there is none.

    `grid` has y and label of each decade, `ticks` x and label of each horizon; a curve has x, y and the interval in y.
    """
    if not ahead:
        return None
    values = [max(v, _MIN_ERROR_M) for error in ahead for v in (*error.before, *error.after, error.noise_floor)]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    high = max(high, low + 1)
    first, last = math.log10(ahead[0].horizon_s), math.log10(ahead[-1].horizon_s)

    def x(horizon_s: float) -> float:
        return 86.0 + (math.log10(horizon_s) - first) / max(last - first, 0.1) * 438.0

    def y(error_m: float) -> float:
        return 220.0 - (math.log10(max(error_m, _MIN_ERROR_M)) - low) / (high - low) * 206.0

    def curve(intervals: Sequence[Interval]) -> list[tuple[float, float, float, float]]:
        return [
            (x(e.horizon_s), y(at), y(bottom), y(top)) for e, (at, bottom, top) in zip(ahead, intervals, strict=True)
        ]

    return {
        "grid": [
            (y(10.0**k), f"{10.0**k * 1e3:g} mm" if k >= -3 else f"{10.0**k * 1e6:g} \u00b5m")
            for k in range(low, high + 1)
        ],
        "ticks": [(x(error.horizon_s), f"{error.horizon_s * 1e3:.0f}") for error in ahead],
        "curves": {
            "noise": curve([(error.noise_floor,) * 3 for error in ahead]),
            "before": curve([error.before for error in ahead]),
            "after": curve([error.after for error in ahead]),
        },
    }
