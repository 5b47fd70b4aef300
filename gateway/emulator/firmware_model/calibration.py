"""The correction of the position sensor through two of its readings: rule 17 of protocol/README.md."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from gateway.emulator.firmware_model.arithmetic import divide_rounded
from protocol.wire.messages import COUNTS_MAX

SPAN_MIN = 2048  # between the two readings
CORRECTION_MAX = 500  # counts at each of them


@dataclass(frozen=True)
class Calibration:
    """Two readings of x without a calibration, and what they should have been, in counts; as it is, none."""

    low_read: int = 0
    low_true: int = 0
    high_read: int = COUNTS_MAX
    high_true: int = COUNTS_MAX

    @cached_property
    def slope(self) -> int:
        """The difference of the slope from 1, in 2^-16: the nearest number, halves away from 0."""
        span = self.high_read - self.low_read
        more = self.high_true - self.low_true - span
        size = divide_rounded(abs(more) << 16, span)
        return size if more >= 0 else -size

    def bound_in_the_way(self) -> int:
        """Return the bound for which a board refuses it; 0 if it does not."""
        if self.high_read < self.low_read + SPAN_MIN:
            return self.low_read + SPAN_MIN
        corrections = abs(self.low_true - self.low_read), abs(self.high_true - self.high_read)
        return CORRECTION_MAX if max(corrections) > CORRECTION_MAX else 0

    def corrected(self, x: int) -> int:
        """Return the count of x for a reading; one at an end of the converter stays there."""
        if x in (0, COUNTS_MAX):
            return x
        above = x - self.low_read
        more = (abs(above * self.slope) + (1 << 15)) >> 16
        value = self.low_true + above + (more if above * self.slope >= 0 else -more)
        return min(max(value, 0), COUNTS_MAX)
