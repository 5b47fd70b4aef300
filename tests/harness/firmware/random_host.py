"""A host, a line and converters that do anything at all, the same for two boards: what the boards do must be the same.

Run as a program with the path of a compiled library, it plays seeds against the model in Python, so that the library
may be one whose compiler watches it: `python -m tests.harness.firmware.random_host LIBRARY TICKS SEED...`
"""

from __future__ import annotations

import random
import sys
from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path

from gateway.emulator.firmware_model.board import AnalogSide, Firmware
from gateway.emulator.firmware_model.flash import FlashLimits, Settings
from gateway.emulator.firmware_model.law import Gains
from gateway.emulator.firmware_model.output import OutputFault
from gateway.emulator.native.board import NativeFirmware
from protocol.wire.codec import BODY_SIZE
from protocol.wire.decoder import StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, ROWS, EventCode, Field, Message, Reason

COMMANDS = [row for row in ROWS if row.to_board]
_SIZES = {"u8": 1, "u16": 2, "i16": 2, "u32": 4}
# How often what comes, for each temper of the host: chances per tick.
_TEMPERS = {
    "calm": {"command": 0.05, "ping": 0.0, "stop": 0.002, "noise": 0.001},
    "busy": {"command": 0.6, "ping": 0.0, "stop": 0.02, "noise": 0.02},
    "flood": {"command": 4.0, "ping": 0.0, "stop": 0.1, "noise": 0.3},
    "gone": {"command": 0.0, "ping": 0.0, "stop": 0.0, "noise": 0.002},
    "patient": {"command": 0.001, "ping": 0.05, "stop": 0.0, "noise": 0.001},  # lets a signal play to its end
}


class Wandering(AnalogSide):
    """Readings that wander about their range and sometimes stick at an end; each look at them is another one.

    Without an input there is mostly no current, as on a rig: else a board would be in a fault all the time.
    """

    def __init__(self, seed: int) -> None:
        self._random, self._loss = random.Random(seed), random.Random(seed + 1)
        self._i_a, self._x_m = 0.6, 2.8e-3
        self._stuck = ""
        self._off = self._leaks = False
        self.inputs = 0  # a hash of every (u, duration)

    def advance(self, u_v: float, duration_s: float) -> None:
        self._off = u_v == 0.0
        self.inputs = hash((self.inputs, u_v, round(duration_s * 1e6)))

    def sense(self) -> tuple[float, float]:
        chance = self._random.random()
        if chance < 0.001:
            self._stuck = self._random.choice(("", "", "i", "top", "bottom"))
        self._i_a = min(max(self._i_a + (chance - 0.5) * 0.02, 0.0), 1.9)
        self._x_m = min(max(self._x_m + (self._random.random() - 0.5) * 4e-5, 1e-4), 5.5e-3)
        i_a = 5.0 if self._stuck == "i" else self._i_a
        if chance > 0.998:
            self._leaks = self._random.random() < 0.1
        if self._off and not self._leaks:
            i_a = min(i_a, 0.05) if self._stuck != "i" else i_a
        return i_a, {"top": 1.0, "bottom": -1.0}.get(self._stuck, self._x_m)

    def drop_sample(self) -> bool:
        return self._loss.random() < 0.01


class Script:
    """The actions before each tick: bytes at a time within it, faults, resets."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._sent: deque[bytes] = deque(maxlen=12)
        self._id = self._session = 1
        self._left = 0
        self._broken = 0  # ticks with a broken stack, before a reset
        self._temper = "calm"
        self.capacity = 64  # frames that the line takes at a tick

    def next(self) -> list[tuple[str, bytes, int]]:
        """Return the actions: (name, data, microseconds into the tick or a number)."""
        chance = self._random
        if self._left == 0:
            self._left = chance.randrange(20, 600)
            self._temper = chance.choices(list(_TEMPERS), (5, 5, 1, 2, 8))[0]
            self.capacity = chance.choices((64, 2, 1, 0), (10, 4, 2, 1))[0]
            if self._temper == "patient":
                self._left = chance.randrange(400, 1500)
                return [("feed", data, 0) for data in self._a_signal()]
        self._left -= 1
        rates = _TEMPERS[self._temper]
        frames = [self._command() for _ in range(self._count(rates["command"]))]
        frames += [_frame("PING", self._next_id()) for _ in range(self._count(rates["ping"]))]
        frames += [_frame("STOP", self._next_id()) for _ in range(self._count(rates["stop"]))]
        frames += [chance.randbytes(chance.randrange(1, 80)) for _ in range(self._count(rates["noise"]))]
        chance.shuffle(frames)
        times = sorted(chance.randrange(2500) for _ in frames)
        actions = [("feed", data, time) for data, time in zip(frames, times, strict=True)]
        what = chance.random()
        self._broken = max(self._broken - 1, 0)
        if self._broken == 1:
            actions.append(("reset", b"", chance.choice((1, 2, 3))))
        elif what > 1 - 2e-4:
            actions.append(("break", b"", 0))
            self._broken = chance.randrange(2, 400)
        elif what < 2e-4:
            actions.append(("hang", b"", 0))
        elif what < 5e-4:
            actions.append(("reset", b"", chance.choice((1, 2, 3))))
        elif what < 4e-3:
            actions.append(("overrun", b"", 0))
        elif what < 5e-3:
            actions.append(("output", b"", chance.choice((0, 0, 0, 0, 1, 2))))
        elif what < 5.5e-3:
            actions.append(("store", b"", chance.getrandbits(32)))
        return actions

    def _count(self, rate: float) -> int:
        whole = int(rate)
        return whole + (self._random.random() < rate - whole)

    def _next_id(self) -> int:
        self._id = self._id % 255 + 1
        return self._id

    def _a_signal(self) -> list[bytes]:
        """A session, a mode, and a signal that fits it."""
        chance = self._random
        target = chance.randrange(2)
        hello = _frame("HELLO", self._next_id(), session=self._session, version_min=1, version_max=1)
        mode = _frame("SET_MODE", self._next_id(), mode=target + 1)
        signal = bytearray((ROW_OF_NAME["EXCITE"].type, self._next_id(), chance.randrange(7), target))
        signal += chance.randint(-900, 900).to_bytes(2, "little", signed=True)
        for low, high in ((1200, 2600), (1, 300), (1, 300), (1, 65535)):
            signal += chance.randint(low, high).to_bytes(2, "little")
        return [hello, mode, encode_frame(bytes(signal) + chance.randrange(800).to_bytes(4, "little"))]

    def _command(self) -> bytes:
        chance = self._random
        kind = chance.random()
        if kind < 0.08 and self._sent:  # a repetition
            return chance.choice(self._sent)
        number = self._next_id() if kind > 0.13 else chance.choice((0, self._id, max(self._id - 5, 1)))
        if kind > 0.85:  # so that there is a session, a mode and a signal most of the time
            if chance.random() < 0.1:
                self._session = chance.randrange(65536)
            data = chance.choice(
                (
                    _frame("HELLO", number, session=self._session, version_min=1, version_max=1),
                    _frame("SET_MODE", number, mode=chance.randrange(3)),
                )
            )
        else:
            row = chance.choice(COMMANDS)
            wild = chance.random() < 0.15
            if row.name == "RESET" and chance.random() < 0.95:
                row = ROW_OF_NAME["EXCITE"]
            body = bytearray((row.type, number))
            for item in row.fields[1:]:
                body += self._value(item, wild=wild).to_bytes(_SIZES[item.type], "little", signed=item.type == "i16")
            if kind < 0.15:
                body = bytearray(self._malformed(bytes(body)))
            data = encode_frame(bytes(body))
        if chance.random() < 0.02:
            damaged = bytearray(data)
            damaged[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            return bytes(damaged)
        self._sent.append(data)
        return data

    def _value(self, item: Field, *, wild: bool) -> int:
        chance = self._random
        size, signed = _SIZES[item.type], item.type == "i16"
        lowest, highest = (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1) if signed else (0, (1 << 8 * size) - 1)
        assert item.low is not None
        assert item.high is not None
        low, high = int(item.low), int(item.high)
        if wild and chance.random() < 0.3:
            return min(max(chance.choice((low - 1, high + 1, lowest, highest)), lowest), highest)
        typical = {
            "x_ref": (300, 3600),
            "amplitude": (-400, 400),
            "offset": (1200, 2600),
            "period": (1, 60),
            "period_end": (1, 60),
            "duration": (0, 300),
            "count": (1, 200),
            "pre": (0, 150),
            "index": (0, 150),
            "divider": (0, 5),
            "timeout": (50, 300),
            "version_min": (0, 2),
            "version_max": (0, 2),
            "low_read": (0, 300),
            "low_true": (0, 600),
            "high_read": (3500, 4095),
            "high_true": (3500, 4095),
        }.get(item.name, (low, high))
        return chance.choice((low, high)) if chance.random() < 0.06 else chance.randint(*typical)

    def _malformed(self, body: bytes) -> bytes:
        chance = self._random
        match chance.randrange(3):
            case 0:
                return body[: chance.randrange(1, len(body) + 1)]
            case 1:
                return body + bytes(chance.randrange(1, 64 - len(body)))
            case _:
                return bytes((chance.randrange(256),)) + body[1:]


@dataclass
class Traffic:
    """The length of a run, and the counts of what it has met, by name."""

    ticks: int = 0
    names: Counter[str] = field(default_factory=Counter)

    def note(self, output: bytes) -> None:
        for event in StreamDecoder().feed(output):
            if isinstance(event, Message):
                self.names[event.name] += 1
                if event.name == "EVENT":
                    self.names[EventCode(event.int("code")).name] += 1
                elif event.name == "NACK":
                    self.names[Reason(event.int("reason")).name] += 1


def play(seed: int, ticks: int, *, path: Path | None = None) -> Traffic:
    """Play the same script to both firmwares; tick by tick, the same frames and the same input must come out.

    Raises:
        AssertionError: they differ; the message has the seed, the tick, both outputs, and what came in.
    """
    script, traffic = Script(seed), Traffic()
    plants = Wandering(seed), Wandering(seed)
    boards = Firmware(plants[0]), NativeFirmware(plants[1], path=path)
    if seed % 2:
        for board in boards:
            board.next_tick = 2**32 - ticks // 2  # the tick wraps on the way
    recent: deque[object] = deque(maxlen=30)
    for n in range(ticks):
        actions = script.next()
        recent.append(actions)
        python, c = (_run_tick(board, actions, script.capacity) for board in boards)
        inputs = [plant.inputs for plant in plants]
        dropped = [board.dropped for board in boards]
        if python != c or inputs[0] != inputs[1] or dropped[0] != dropped[1]:
            raise AssertionError(
                f"seed {seed}, tick {n}: Python sent {StreamDecoder().feed(python)}, C {StreamDecoder().feed(c)}; "
                f"u {boards[0].u} and {boards[1].u}, lost {dropped}; before that came {list(recent)}"
            )
        if len(c) != BODY_SIZE["STATE"] + 5:
            traffic.note(c)
    traffic.ticks = ticks
    return traffic


def _run_tick(board: Firmware | NativeFirmware, actions: list[tuple[str, bytes, int]], capacity: int) -> bytes:
    for name, data, number in actions:
        if name == "feed":
            board.feed(data, into_tick_us=number)
        elif name == "hang":
            board.hang()
        elif name == "overrun":
            board.overrun()
        elif name == "break":
            board.break_stack()
        elif name == "output":
            board.fail_output(OutputFault(number))
        elif name == "store":
            board.store(random_settings(random.Random(number)))
        else:
            board.reset(EventCode(number))
    board.tick()
    return b"".join(board.take_frame() for _ in range(capacity))


def random_settings(chance: random.Random) -> Settings:
    """Return settings as a memory may hold them: each field what its type holds, most of the time in its range."""

    def number(low: int, high: int, lowest: int, highest: int) -> int:
        kind = chance.random()
        if kind < 0.04:
            return chance.randint(lowest, highest)
        if kind < 0.06:
            return min(max(chance.choice((low - 1, high + 1, low, high)), lowest), highest)
        return chance.randint(low, high)

    def counts(low: int = 0, high: int = 4095) -> int:
        return number(low, high, 0, 65535)

    m1, m2, m3, m4 = (number(-32767, 32767, -32768, 32767) for _ in range(4))
    s1, s2, s3, s4 = (number(0, 30, 0, 255) for _ in range(4))
    low, high = counts(), counts()
    if chance.random() < 0.9:
        low, high = min(low, high), max(low, high)
    return Settings(
        gains=Gains(
            law=number(0, 1, 0, 255),
            mantissas=(m1, m2, m3, m4),
            shifts=(s1, s2, s3, s4),
            i_0=counts(),
            x_0=counts(),
            u_0=counts(),
        ),
        limits=FlashLimits(
            x_ref_min=low, x_ref_max=high, x_ref_step=counts(), x_ref_slew=counts(1, 65535), u_max=counts()
        ),
    )


def _frame(name: str, number: int, /, **fields: int) -> bytes:
    body = bytearray((ROW_OF_NAME[name].type, number))
    for item in ROW_OF_NAME[name].fields[1:]:
        body += fields[item.name].to_bytes(_SIZES[item.type], "little")
    return encode_frame(bytes(body))


if __name__ == "__main__":
    for argument in sys.argv[3:]:
        print(play(int(argument), int(sys.argv[2]), path=Path(sys.argv[1])))
