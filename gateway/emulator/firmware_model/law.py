"""The control law on the board, in counts and integers: rule 9 of protocol/README.md, eq. (16)-(19) of the paper.

Format: gains are 16-bit mantissas with a right shift; deviations have 16 bits.  The integral is a saturating 24-bit
integer.  Products have 32 and 40 bits, the accumulator 32 bits with 8 fraction bits (Q23.8).

Error against the same law in floating point, over 20 000 states of the working range (test_firmware_law.py):

    before rounding to the converter   at most 0.25 counts of u, 0.09 rms
    with rounding                      at most 0.66 counts of u, 0.30 rms
    rounding only (unavoidable)        at most 0.50 counts of u, 0.29 rms

So fixed point adds 3 % to the noise of the 12-bit converter; one count is 1.22 mV.
"""

from __future__ import annotations

from dataclasses import dataclass

from gateway.emulator.firmware_model.arithmetic import FRACTION_BITS, saturate, scaled_product
from protocol.wire.messages import COUNTS_MAX, Law

SUM_BITS = 24
_HALF = 1 << FRACTION_BITS - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """The gains of SET_GAINS: gain n is mantissas[n] * 2^-shifts[n], in counts of u_c per count."""

    law: int  # messages.Law
    mantissas: tuple[int, ...]  # four
    shifts: tuple[int, ...]
    i_0: int  # operating point (13), counts
    x_0: int
    u_0: int


class ControlLaw:
    """The control law with its gains and its state: integral of the error, last position."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self.sum = 0
        self._x_previous: int | None = None

    def reset(self) -> None:
        """Reset the state, as on entering closed loop: integral 0, and speed 0 at the next tick."""
        self.sum = 0
        self._x_previous = None

    def accumulate(self, i: int, x: int, x_ref: int) -> int:
        """Return the input u before rounding and limits, in 1/256 counts, with the current integral."""
        gains = self.gains
        (m1, m2, m3, m4), (s1, s2, s3, s4) = gains.mantissas, gains.shifts
        step = 0 if self._x_previous is None else x - self._x_previous
        u = gains.u_0 << FRACTION_BITS
        if gains.law == Law.LQI:
            u = saturate(u - scaled_product(m1, s1, i - gains.i_0), 32)
            u = saturate(u - scaled_product(m2, s2, x - gains.x_0), 32)
            u = saturate(u - scaled_product(m3, s3, step), 32)
            return saturate(u - scaled_product(m4, s4, self.sum), 32)
        u = saturate(u + scaled_product(m1, s1, x_ref - x), 32)
        u = saturate(u + scaled_product(m2, s2, self.sum), 32)
        return saturate(u - scaled_product(m3, s3, step), 32)

    def run(self, i: int, x: int, x_ref: int) -> tuple[int, bool]:
        """Run one tick: return (u_c in counts, whether it was limited), and advance the integral."""
        unlimited = self.accumulate(i, x, x_ref) + _HALF >> FRACTION_BITS
        u = min(max(unlimited, 0), COUNTS_MAX)
        error = x_ref - x
        # Anti-windup: the sign of du/dsum decides which error would push u further past the limit it is at.
        rise = -self.gains.mantissas[3] if self.gains.law == Law.LQI else self.gains.mantissas[1]
        if not (unlimited > COUNTS_MAX and error * rise > 0) and not (unlimited < 0 and error * rise < 0):
            self.sum = saturate(self.sum + error, SUM_BITS)
        self._x_previous = x
        return u, unlimited != u
