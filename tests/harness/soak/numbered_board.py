"""Boards whose samples bear numbers, and a ledger of how far each sample came before it left the emulator.

A sample's number is in what its pins carry: i_c has the lower 12 bits, x the upper.  It counts over resets, so for nine
hours at 500 Hz no two samples of a board are alike, whatever session or tick a gateway gives them.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Iterator
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from gateway.emulator.firmware_model.board import AnalogSide, Firmware
from gateway.emulator.firmware_model.flash import CE152_BOARD, CURRENT, POSITION, BoardProfile
from gateway.emulator.ports import EmulatedPort
from protocol.wire.decoder import State, StreamDecoder

_BITS = 12
_LOW = (1 << _BITS) - 1


def number_of(i_count: int, x_count: int) -> int:
    """Return the number of the sample with these counts."""
    return i_count | x_count << _BITS


def numbers_of(i_c_a: NDArray[np.float64], x_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the numbers of samples in SI units, with the scalings of the emulated board."""
    i = np.rint((i_c_a - CURRENT.offset) / CURRENT.lsb).astype(np.int64)
    x = np.rint((x_m - POSITION.offset) / POSITION.lsb).astype(np.int64)
    return i | x << _BITS


class Fate(IntEnum):
    """How far a sample came; each includes the ones before."""

    SENSED = 0
    SENT = 1  # by the board
    INTACT = 2  # at the end of the line, after the faults of the line
    TAKEN = 3  # by the port of the host


class Ledger:
    """The samples of one board by number, with the time of the last that is known of each; number 0 is none."""

    def __init__(self) -> None:
        self.fate, self.at_ns = array("B", [Fate.SENSED]), array("q", [0])
        self.opened_ns: list[int] = []  # when a host came
        self.closed_ns: list[int] = []  # when the board was unplugged

    def sense(self) -> int:
        """Begin a new sample and return its number."""
        self.fate.append(Fate.SENSED)
        self.at_ns.append(time.monotonic_ns())
        return len(self.fate) - 1

    def came(self, number: int, fate: Fate) -> None:
        """Note how far a sample came; noise with a right CRC may name any number."""
        if 0 < number < len(self.fate):
            self.fate[number] = max(self.fate[number], fate)
            self.at_ns[number] = time.monotonic_ns()  # a line that stalls keeps samples for a second


class NumberedPins(AnalogSide):
    """Pins that carry the number of the sample."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger

    def advance(self, u_v: float, duration_s: float) -> None:
        """Nothing moves here."""

    def sense(self) -> tuple[float, float]:
        number = self._ledger.sense()
        return CURRENT.to_si(number & _LOW), POSITION.to_si(number >> _BITS)

    def drop_sample(self) -> bool:
        return False


class NumberedBoard(Firmware):
    """A board that notes which samples it has sent."""

    def __init__(self, ledger: Ledger, *, board_id: int, profile: BoardProfile = CE152_BOARD) -> None:
        super().__init__(NumberedPins(ledger), board_id=board_id, profile=profile)
        self._ledger = ledger

    def take_frame(self) -> bytes:
        frame = super().take_frame()
        for number in _numbers(StreamDecoder(), frame):
            self._ledger.came(number, Fate.SENT)
        return frame


class LedgerPort:
    """A port that notes which samples arrive at it undamaged, and which of them its host takes."""

    def __init__(self, port: EmulatedPort, ledger: Ledger) -> None:
        self._port, self._ledger = port, ledger
        self._offered, self._taken = StreamDecoder(), StreamDecoder()
        self._read = False  # by a host

    @property
    def url(self) -> str:
        return self._port.url

    def open(self, *, renamed: bool = False) -> None:
        self._port.open(renamed=renamed)

    def close(self) -> None:
        self._ledger.closed_ns.append(time.monotonic_ns())
        self._port.close()

    def connected(self) -> bool:
        return self._port.connected()

    def read(self, limit: int) -> bytes:
        return self._port.read(limit)

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        for number in _numbers(self._offered, data):
            self._ledger.came(number, Fate.INTACT)
        count = self._port.write(data, wait_s)
        if count and not self._read:
            self._ledger.opened_ns.append(time.monotonic_ns())
        self._read = count > 0
        for number in _numbers(self._taken, data[:count]):
            self._ledger.came(number, Fate.TAKEN)
        if count < len(data):  # the next host begins anew; for the same one, the next frame has its own delimiter
            self._taken = StreamDecoder()
        return count


def _numbers(decoder: StreamDecoder, data: bytes) -> Iterator[int]:
    return (number_of(event.i_c, event.x) for event in decoder.feed(data) if isinstance(event, State))
