"""The input converter, and what the firmware knows of it: the last half of rule 11 of protocol/README.md.

Rule 1: `InputConverter` is hardware: it outlives a reset of the program.  `Output` is the program's.
Rule 2: u_c is what the converter confirmed last.  Before it has confirmed anything it may give all it can.
"""

from __future__ import annotations

from enum import IntEnum

from protocol.wire.messages import COUNTS_MAX

UNCONFIRMED_TICKS = 5
UNCOMMANDED_TICKS = 100
UNCOMMANDED_CURRENT_COUNTS = 512


class OutputFault(IntEnum):
    """The faults of a converter."""

    NONE = 0
    DEAF = 1  # it confirms nothing, and keeps its output
    STUCK = 2  # it confirms everything, and keeps its output


class InputConverter:
    """The converter of u_c."""

    def __init__(self) -> None:
        self.count = 0  # on its pin
        self.fault = OutputFault.NONE

    def write(self, count: int) -> bool:
        """Take over a count; return whether the converter confirms it."""
        if self.fault == OutputFault.NONE:
            self.count = count
        return self.fault != OutputFault.DEAF


class Output:
    """The output confirmed since the reset, and for how many ticks in a row the converter has failed."""

    def __init__(self, converter: InputConverter) -> None:
        self._converter = converter
        self.u = COUNTS_MAX
        self._confirmed = False
        self._unconfirmed_ticks = 0
        self._current_ticks = 0
        self._off = False  # at the end of the tick before: 0 was confirmed, and no capture ran
        self.write(0)

    def write(self, count: int) -> None:
        """Write a count; if it is not confirmed, `u` stays what it was."""
        self._confirmed = self._converter.write(count)
        if self._confirmed:
            self.u = count

    def rearm(self) -> None:
        """Forget the reported faults after SET_MODE: a fault that persists is raised again at this tick."""
        self._unconfirmed_ticks = min(self._unconfirmed_ticks, UNCONFIRMED_TICKS - 1)
        self._current_ticks = min(self._current_ticks, UNCOMMANDED_TICKS - 1)

    def is_unconfirmed(self) -> bool:
        """Return whether to raise OUTPUT_FAULT; call it once per tick, after the write."""
        self._unconfirmed_ticks = 0 if self._confirmed else self._unconfirmed_ticks + 1
        return self._unconfirmed_ticks == UNCONFIRMED_TICKS

    def is_bypassed(self, i: int) -> bool:
        """Return whether to raise UNCOMMANDED_CURRENT; call it once per tick, after the write."""
        self._current_ticks = self._current_ticks + 1 if self._off and i >= UNCOMMANDED_CURRENT_COUNTS else 0
        return self._current_ticks == UNCOMMANDED_TICKS

    def end_tick(self, *, capturing: bool) -> None:
        """Note for the next tick whether the coil has to be without current until then."""
        self._off = self.u == 0 and not capturing
