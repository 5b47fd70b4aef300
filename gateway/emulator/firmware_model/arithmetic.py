"""Integer arithmetic of an 8051: saturation, scaled products, rounded quotients, a sine table.

Rule 1: integers only.  Products are 16 x 16 -> 32 bits or 16 x 24 -> 40 bits, quotients 32 / 16; nothing wider exists
        on the board.
Rule 2: results that do not fit saturate and never wrap: a wrapped sum would drive the ball into a stop.
"""

from __future__ import annotations

import math

FRACTION_BITS = 8  # of the 32-bit accumulator: Q23.8
PHASE_BITS = 32  # a phase is a fraction of a turn, modulo 2^32

_TABLE_BITS = 8
# Code memory of the firmware: one turn in 256 steps, Q15; the first entry is repeated at the end, for interpolation.
_SINE_Q15 = tuple(round(32767 * math.sin(math.tau * n / 2**_TABLE_BITS)) for n in range(2**_TABLE_BITS + 1))


def saturate(value: int, bits: int) -> int:
    """Return the nearest two's complement number of `bits` bits."""
    top = 1 << bits - 1
    return -top if value < -top else top - 1 if value >= top else value


def scaled_product(mantissa: int, shift: int, operand: int) -> int:
    """Return mantissa * 2^-shift * operand in the accumulator's format, Q23.8, truncated, saturated to 32 bits.

    Truncation (towards minus infinity) costs at most 1/256 of a count per term; a rounding shift would cost 40
    machine cycles per term to save a hundredth of what the converter's own rounding does.
    """
    product = mantissa * operand
    move = shift - FRACTION_BITS
    return saturate(product >> move if move >= 0 else product << -move, 32)


def divide_rounded(numerator: int, denominator: int) -> int:
    """Return numerator / denominator, rounded to the nearest integer, halves upwards; denominator > 0."""
    return (2 * numerator + denominator) // (2 * denominator)


def sine_q15(phase: int) -> int:
    """Return 32767 sin(2 pi phase / 2^32), by a table of 256 steps with linear interpolation; error at most 4."""
    phase &= 0xFFFFFFFF
    index = phase >> PHASE_BITS - _TABLE_BITS
    fraction = phase >> PHASE_BITS - _TABLE_BITS - 8 & 0xFF
    low = _SINE_Q15[index]
    return low + ((_SINE_Q15[index + 1] - low) * fraction >> 8)
