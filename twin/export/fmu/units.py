"""Units as FMI asks for them: each as powers of the SI base units."""

from __future__ import annotations

import re
from collections import Counter

_BASE: dict[str, dict[str, int]] = {
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^(-?\d+))?")


def exponents(unit: str) -> dict[str, int]:
    """Return the powers of kg, m, s, A of a unit such as `N m^2/A^2` or `V/(m s)`; all behind `/` divides."""
    over, _, under = unit.partition("/")
    powers: Counter[str] = Counter()
    for part, sign in ((over, 1), (under, -1)):
        for symbol, power in _FACTOR.findall(part):
            for base, exponent in _BASE.get(symbol, {}).items():
                powers[base] += sign * exponent * int(power or 1)
    return {base: power for base, power in powers.items() if power}
