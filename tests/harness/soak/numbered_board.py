"""Boards whose samples bear numbers, and a ledger of how far each sample came before it left the emulator.

The ledger also says which samples came to the host before the end of a handshake: a host ignores them.

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
from protocol.wire.messages import EventCode, Message

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
    """The stations of a sample; each includes the ones before."""

    SENSED = 0
    SENT = 1  # by the board
    INTACT = 2  # at the end of the line, after the faults of the line
    RECEIVED = 3  # by the port of the host


class Ledger:
    """The samples of one board by number, with the time of the last that is known of each; number 0 is none."""

    def __init__(self) -> None:
        self.fate, self.at_ns = array("B", [Fate.SENSED]), array("q", [0])
        self.early = array("B", [False])  # taken before the end of a handshake
        self.opened_ns: list[int] = []  # when a host came
        self.closed_ns: list[int] = []  # when the board was unplugged
        self._early_from: int | None = 0  # samples from this one on come before the end of a handshake
        self._hello = 0  # id of the newest one

    def sense(self) -> int:
        """Begin a new sample and return its number."""
        self.fate.append(Fate.SENSED)
        self.early.append(False)
        self.at_ns.append(time.monotonic_ns())
        return len(self.fate) - 1

    def came(self, number: int, fate: Fate) -> None:
        """Note how far a sample came; noise with a right CRC may name any number."""
        if 0 < number < len(self.fate):
            self.fate[number] = max(self.fate[number], fate)
            self.at_ns[number] = time.monotonic_ns()  # a line that stalls keeps samples for a second
            if fate == Fate.RECEIVED and self._early_from is not None and number >= self._early_from:
                self.early[number] = True

    def reset(self) -> None:
        """Note that the board restarts: the samples from now on need a handshake."""
        if self._early_from is None:
            self._early_from = len(self.fate)  # what a stalled line still keeps is from before

    def opened(self) -> None:
        """Note that a host has come."""
        self.opened_ns.append(time.monotonic_ns())
        self._early_from = 0

    def note_hello(self, hello: int) -> None:
        """Note a HELLO of the host, by its id; the same one again begins nothing: its answer may have come."""
        if hello != self._hello:
            self._early_from, self._hello = 0, hello

    def answered(self, hello: int) -> None:
        """Note that the host has taken the answer to a HELLO."""
        if hello == self._hello:
            self._early_from = None


class NumberedPins(AnalogSide):
    """Pins that carry the number of the sample."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger

    def advance(self, u_v: float, duration_s: float) -> None:
        """Do nothing: this plant has no motion."""

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

    def reset(self, cause: EventCode) -> None:
        super().reset(cause)
        self._ledger.reset()


class LedgerPort:
    """A port that notes which samples arrive at it undamaged, which of them its host takes, and the handshakes."""

    def __init__(self, port: EmulatedPort, ledger: Ledger) -> None:
        self._port, self._ledger = port, ledger
        self._offered, self._received, self._requests = StreamDecoder(), StreamDecoder(), StreamDecoder()
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
        data = self._port.read(limit)
        for event in self._requests.feed(data):
            if isinstance(event, Message) and event.name == "HELLO":
                self._ledger.note_hello(event.int("id"))
        return data

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        for number in _numbers(self._offered, data):
            self._ledger.came(number, Fate.INTACT)
        count = self._port.write(data, wait_s)
        if count and not self._read:
            self._ledger.opened()
        self._read = count > 0
        for event in self._received.feed(data[:count]):
            if isinstance(event, State):
                self._ledger.came(number_of(event.i_c, event.x), Fate.RECEIVED)
            elif isinstance(event, Message) and event.name == "IDENTITY":
                self._ledger.answered(event.int("id"))
        if count < len(data):  # the next host begins anew; for the same one, the next frame has its own delimiter
            self._received = StreamDecoder()
        return count


def _numbers(decoder: StreamDecoder, data: bytes) -> Iterator[int]:
    return (number_of(event.i_c, event.x) for event in decoder.feed(data) if isinstance(event, State))
