"""Boards whose firmware runs as the image of a chip, instruction by instruction, in a simulator of that chip.

    board = CHIPS["avr"](EmulatedPlant(), board_id=1, baud=115200)

A chip has the seams of `gateway.emulator.line.Board`.  Its time is that of its cycles, its line that of its UART.
"""

from collections.abc import Mapping
from typing import Protocol

from gateway.emulator.chip.avr.board import AvrBoard
from gateway.emulator.chip.mcs51.board import Mcs51Board
from gateway.emulator.firmware.board import AnalogSide
from gateway.emulator.firmware.flash import CE152_BOARD, BoardProfile
from gateway.emulator.line import Board


class MakeChip(Protocol):
    """Makes a board, powered on; raises InstallError where compiler or simulator are missing."""

    def __call__(
        self, plant: AnalogSide, *, board_id: int = 1, baud: int = 115200, profile: BoardProfile = CE152_BOARD
    ) -> Board:
        """Return the board on this plant, its UART at `baud`."""


CHIPS: Mapping[str, MakeChip] = {"avr": AvrBoard, "8051": Mcs51Board}
