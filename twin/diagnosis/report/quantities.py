"""Numbers for people: quantities with their unit, shares, ratios and lengths.

Rule: a number has as many digits as its interval leaves it; both ends of an interval are in the unit of the number.
"""

from __future__ import annotations

import math

from twin.page import plain

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"))
_SCALED = ("m", "A", "s", "N", "V", "m/A")


def quantity(value: float, unit: str) -> str:
    """A number with its unit at a readable power of ten."""
    factor, scaled_unit = scale_of(value, unit)
    digits = ".3g" if factor != 1.0 else ".4g"
    return f"{value / factor:{digits}} {scaled_unit}".rstrip()


def measured(value: float, ci95: tuple[float, float] | None, unit: str) -> tuple[str, str]:
    """Return (the number with its unit, its interval, or ""), with the digits that the interval leaves."""
    if ci95 is None:
        return quantity(value, unit), ""
    factor, scaled_unit = scale_of(value, unit)
    half = 0.5 * (ci95[1] - ci95[0]) / factor
    if not 0.0 < half < math.inf or not 1e-4 <= abs(value / factor) < 1e5:
        return quantity(value, unit), f"{quantity(ci95[0], unit)} to {quantity(ci95[1], unit)}"
    # Two digits of the error, from 3 on one: more say nothing, and fewer would change the interval visibly.
    first = math.floor(math.log10(half))
    places = min(max(-first if half >= 3.0 * 10.0**first else 1 - first, 0), 6)
    number, low, high = (f"{end / factor:.{places}f}" for end in (value, *ci95))
    return f"{number} {scaled_unit}".rstrip(), f"{low} to {high} {scaled_unit}".rstrip()


def scale_of(value: float, unit: str) -> tuple[float, str]:
    """Return (factor, unit with its prefix) in which the value is readable."""
    if unit in _SCALED and 0.0 < abs(value) < 0.1:
        factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= 0.1 * f), _PREFIXES[-1])
        return factor, prefix + unit
    return 1.0, unit


def times(ratio: float) -> str:
    """Format a ratio of errors; a number over 100 says nothing, as the prediction has left the travel."""
    return "over 100" if ratio > 100.0 else f"{ratio:.2g}"


def percent(share: float) -> str:
    """Format a share in percent, bounded at 1 % and 99 %: no cause explains everything."""
    return "over 99 %" if share > 0.995 else "less than 1 %" if share < 0.005 else f"{100.0 * share:.0f} %"


def micrometres(value_m: float) -> str:
    """Format a length with three digits and its unit, never with an exponent."""
    micro = value_m * 1e6
    return f"{micro / 1e3:.3g} mm" if micro >= 1e3 else f"{plain.micrometres(value_m)} µm"
