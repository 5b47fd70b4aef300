"""The simulated 8051 on a bench: readings by the tick, a host with the line's timing, and what both cores sent."""

from __future__ import annotations

import random
import shutil
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

import pytest

from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.firmware_model.board import AnalogSide
from gateway.emulator.firmware_model.flash import CURRENT, POSITION, T_S_US
from gateway.emulator.native.board import NativeFirmware
from protocol.wire.framing import cobs_decode, encode_frame
from protocol.wire.messages import ROW_OF_NAME, ROWS
from tests.harness.gateway.board_host import frame, skip_without_compiler
from tests.harness.protocol.port import take_output

BYTE_US = 87  # of a line at 115200 baud
ROOM_US = 300  # after a tick of the loop: a frame that ends there is executed before the next
EVERY = 12  # ticks from a command to the next, so that the line has time for all answers
_MESSAGES = {row.type: row.name for row in ROWS}


def skip_without_sdcc() -> None:
    skip_without_compiler()
    if shutil.which("sdcc") is None:
        pytest.skip("sdcc is not installed")


class Readings(AnalogSide):
    """Counts that wander from tick to tick, the same for every board that begins tick 0 at `first_us`."""

    def __init__(self, seed: int, ticks: int, first_us: int) -> None:
        chance = random.Random(seed)
        self._first_us, self._us = first_us, 0
        self._counts = [(1300, 2000)]
        for _ in range(ticks):
            i, x = self._counts[-1]
            i, x = i + chance.randint(-20, 20), x + chance.randint(-30, 30)
            self._counts.append((min(max(i, 100), 4000), min(max(x, 100), 4000)))
        for _ in range(ticks // 400):  # a converter at its end for a while, longer than a fault takes
            at, channel = chance.randrange(ticks - 80), chance.randrange(2)
            for n in range(at, at + chance.choice((20, 70))):
                i, x = self._counts[n]
                self._counts[n] = (4095, x) if channel else (i, chance.choice((0, 4095)))
        self.looks: list[int] = []

    def advance(self, u_v: float, duration_s: float) -> None:
        self._us += round(duration_s * 1e6)

    def sense(self) -> tuple[float, float]:
        self.looks.append(self._us)
        i, x = self._counts[max((self._us - self._first_us + T_S_US // 2) // T_S_US, 0)]
        return CURRENT.to_si(i), POSITION.to_si(x)

    def drop_sample(self) -> bool:
        return False


@dataclass
class Sent:
    """The output of a board: frames of each queue in their order."""

    frames: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    _rest: bytes = b""

    def take(self, data: bytes) -> None:
        *pieces, self._rest = (self._rest + data).split(b"\0")
        for piece in pieces:
            if piece:
                body = (cobs_decode(piece) or b"")[:-2]
                name = _MESSAGES[body[0]]
                body = body[:-8] if name == "IDENTITY" else body  # without the build
                self.frames[name if name in ("STATE", "EVENT") else "answers"].append(body)


def first_look_us() -> int:
    """Return the time at which a chip begins its tick 0, in us after power-on."""
    readings = Readings(0, 0, 10**9)
    board = Mcs51Board(readings)
    while not readings.looks:
        board.tick()
    return readings.looks[0]


def commands(seed: int, ticks: int) -> list[tuple[int, bytes]]:
    """A random host: frames, and the tick after which each is complete."""
    chance = random.Random(seed)
    frames = [(3, frame("HELLO", id=1, session=7, version_min=1, version_max=1))]
    for n, tick in enumerate(range(3 + EVERY, ticks - EVERY, EVERY)):
        frames.append((tick, _command(chance, n % 255 + 1)))
    return frames


def _command(chance: random.Random, number: int) -> bytes:
    kind = chance.random()
    if kind < 0.2:
        return frame("SET_MODE", id=number, mode=chance.choice((0, 1, 2, 2)))
    if kind < 0.3:
        return frame("SET_REFERENCE", id=number, x_ref=chance.randrange(200, 3800))
    if kind < 0.5:
        target = chance.randrange(2)
        return frame(
            "EXCITE",
            id=number,
            shape=chance.randrange(7),
            target=target,
            amplitude=chance.randint(-400, 400),
            offset=chance.randrange(1200, 2600),
            period=chance.choice((1, 2, 7, 30, 300, 65535)),
            period_end=chance.choice((1, 2, 20, 500, 65535)),
            seed=chance.randrange(1, 65536),
            duration=chance.choice((0, 1, 5, 30, 200, 70000, 2**32 - 1)),
        )
    if kind < 0.6:
        gains = {f"k{n}_mantissa": chance.randint(-32767, 32767) for n in range(1, 5)}
        gains |= {f"k{n}_shift": chance.randrange(31) for n in range(1, 5)}
        points = {name: chance.randrange(4096) for name in ("i_0", "x_0", "u_0")}
        return frame("SET_GAINS", id=number, law=chance.randrange(2), **gains, **points)
    if kind < 0.65:
        return frame("SET_STREAM", id=number, divider=chance.choice((0, 1, 1, 2, 3)))
    if kind < 0.7:
        return frame("SET_HOST_LOSS", id=number, policy=chance.randrange(3), timeout=chance.choice((50, 5000)))
    if kind < 0.75:
        row = ROW_OF_NAME[chance.choice(("SET_GAINS", "EXCITE", "PING", "SET_MODE"))]  # malformed
        return encode_frame(bytes((row.type, number)) + chance.randbytes(chance.randrange(20)))
    name = chance.choice(("PING", "GET_PARAMETERS", "STOP", "READ_CAPTURE"))
    return frame(name, id=number, **({"index": 3} if name == "READ_CAPTURE" else {}))


def play_to_chip(readings: Readings, sent: Sent, script: Iterable[tuple[int, bytes]], ticks: int) -> Mcs51Board:
    """Let the host's bytes come so that the last of each frame is in ROOM_US after its tick."""
    board = Mcs51Board(readings)
    while not readings.looks:
        board.tick()
    todo = sorted((after * T_S_US + ROOM_US - len(data) * BYTE_US, data) for after, data in script)
    for tick in range(1, ticks):
        while todo and todo[0][0] < (tick + 1) * T_S_US:
            at_us, data = todo.pop(0)
            board.feed(data, into_tick_us=at_us - tick * T_S_US)
        board.tick()
        sent.take(take_output(board))
    return board


def play_to_core(board: NativeFirmware, sent: Sent, script: Iterable[tuple[int, bytes]], ticks: int) -> None:
    """Let each frame come between its tick and the next."""
    todo = sorted(script)
    for tick in range(ticks):
        board.tick()
        sent.take(take_output(board))
        while todo and todo[0][0] == tick:
            board.feed(todo.pop(0)[1])
