"""Boards whose firmware runs as the image of a chip, instruction by instruction, in a simulator of that chip.

    board = CHIPS["avr"](EmulatedPlant(), board_id=1, baud=115200)

A chip is a `gateway.emulator.line.Board`.  Its time is that of its cycles, its line that of its UART.
"""

from collections.abc import Callable, Mapping

from firmware.sim.avr.board import AvrBoard
from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.line import Board

CHIPS: Mapping[str, Callable[..., Board]] = {"avr": AvrBoard, "8051": Mcs51Board}
