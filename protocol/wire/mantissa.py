"""The format of a control gain: mantissa * 2^-shift (protocol/README.md, *Arithmetic of the board*)."""

from __future__ import annotations

from typing import Final

MANTISSA_MAX: Final = 32767
SHIFT_MAX: Final = 30


def to_mantissa(gain: float) -> tuple[int, int]:
    """Return (mantissa, shift) nearest to `gain`, with as many bits of mantissa as fit.

    Raises:
        OverflowError: |gain| does not round to MANTISSA_MAX or less.
    """
    if abs(gain) >= MANTISSA_MAX + 0.5:
        raise OverflowError(gain)
    if gain == 0:
        return 0, 0
    shift = SHIFT_MAX
    # Tried, not computed by a logarithm: rounding may carry a mantissa beyond its range.
    while abs(round(gain * 2.0**shift)) > MANTISSA_MAX:
        shift -= 1
    return round(gain * 2.0**shift), shift
