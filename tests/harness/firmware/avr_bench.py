"""A simulated ATmega328P on a bench, for tests: a host at its UART, its cycles counted."""

from __future__ import annotations

import pytest

from firmware.sim.avr.board import AvrBoard
from firmware.sim.avr.build import missing
from tests.harness.firmware.chip_host import ChipHost


def skip_without_avr() -> None:
    absent = missing()
    if absent is not None:
        pytest.skip(f"the simulated AVR needs avr-gcc and libsimavr (Debian: libsimavr-dev), and {absent} is not there")


class AvrHost(ChipHost[AvrBoard]):
    """A host; `cycles` has those of each tick in which the chip was awake."""

    def __init__(self, board: AvrBoard) -> None:
        super().__init__(board)
        self.cycles: list[int] = []

    def run(self, ticks: int = 1) -> None:
        """Let ticks pass."""
        for _ in range(ticks):
            before = self.board.cycles_awake
            super().run()
            self.cycles.append(self.board.cycles_awake - before)
