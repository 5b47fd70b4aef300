"""Boards as a load: N ptys, one STATE frame each every 2 ms, answers to what a gateway asks.  A process of its own.

    python load.py FOLDER BOARDS SECONDS

The emulator is no load for 32 boards on two cores: its physics costs more than the gateway.  So the frames are encoded
before the start, with their sequence numbers, from one recorded second of an emulated board, and only written here;
the boards are staggered within the 2 ms as unsynchronised boards are.  When each frame was handed to the kernel is
kept and written to FOLDER/written.npy at the end: [board, tick] -> CLOCK_MONOTONIC in ns, 0 where it was not.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import time
import tty
from pathlib import Path

import numpy as np

from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, Message
from tests.harness.protocol.port import take_output

PERIOD_NS = 2_000_000
STAGGER = 4  # groups of boards within a period


def recorded_states(count: int) -> list[State]:
    """States of an emulated board in closed loop, after it has lifted the ball."""
    board = Firmware(EmulatedPlant(seed=51), board_id=1)
    board.feed(encode_frame(encode_body("HELLO", id=1, session=1, version_min=1, version_max=1)))
    board.feed(encode_frame(encode_body("SET_MODE", id=2, mode=2)))
    decoder, states = StreamDecoder(), list[State]()
    while len(states) < count + 1000:
        board.tick()
        states += [event for event in decoder.feed(take_output(board)) if isinstance(event, State)]
    return states[1000:]


def encode(states: list[State], count: int) -> list[bytes]:
    """Frames of ticks 0 .. count-1."""
    frames = []
    for tick in range(count):
        state = states[tick % len(states)]
        values = {**state._asdict(), "sequence": tick & 0xFFFF}
        frames.append(encode_frame(encode_body("STATE", **values)))
    return frames


def reply(command: Message, tick: int, board: int) -> bytes:
    """Return the body of a board's answer."""
    number = command.int("id")
    match command.name:
        case "HELLO":
            scalings = {"i_offset": 0.0, "i_lsb": 2 / 4096, "x_offset": -54e-6, "x_lsb": 5 / 4096 / 855}
            return encode_body(
                "IDENTITY", id=number, version=1, firmware_major=1, firmware_minor=0, board_id=board + 1,
                tick=tick, sample_time=2000, adc_bits=12, dac_bits=12, **scalings, u_offset=0.0, u_lsb=5 / 4096,
                capture_time=40, capture_size=2000, reset_cause=1, build=b"load    ",
            )  # fmt: skip
        case "PING":
            return encode_body("PONG", id=number, tick=tick, bad_frames=0, overruns=0)
        case "GET_PARAMETERS":
            gains = {f"k{n}_{part}": 0 for n in range(1, 5) for part in ("mantissa", "shift")}
            limits = {"x_ref_min": 0, "x_ref_max": 4095, "x_ref_step": 1000, "x_ref_slew": 1000, "u_max": 4095}
            return encode_body(
                "PARAMETERS", id=number, law=0, **gains, i_0=0, x_0=0, u_0=0, **limits, divider=1, policy=0,
                timeout=1000, tick=0,
            )  # fmt: skip
        case _:
            return encode_body("ACK", id=number, command=ROW_OF_NAME[command.name].type, tick=tick)


class Board:
    """The writing end of one pty."""

    def __init__(self, folder: Path, number: int) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self._slave = slave  # held open: bytes that nobody reads wait as in a UART's buffer, EIO never comes
        (folder / f"tty{number}").symlink_to(os.ttyname(slave))
        self._decoder = StreamDecoder()
        self._number = number

    def answer(self, tick: int) -> None:
        """Reply to whatever commands are waiting."""
        with contextlib.suppress(BlockingIOError):
            for event in self._decoder.feed(os.read(self.master, 4096)):
                if isinstance(event, Message):
                    os.write(self.master, encode_frame(reply(event, tick, self._number)))


def main(folder: Path, count: int, seconds: float) -> None:
    """Write until the time is over or SIGTERM."""
    gc.disable()  # its pauses would be counted as the latency of what is measured
    ticks = round(seconds * 1e9 / PERIOD_NS)
    frames = encode(recorded_states(1000), ticks)
    boards = [Board(folder, number) for number in range(count)]
    written = np.zeros((count, ticks), np.int64)
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(1))
    print("ready", flush=True)
    start = time.monotonic_ns() + PERIOD_NS
    for step in range(ticks * STAGGER):
        tick, group = divmod(step, STAGGER)
        wait = start + step * PERIOD_NS // STAGGER - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)
        for number in range(group, count, STAGGER):
            stamp = time.monotonic_ns()
            with contextlib.suppress(BlockingIOError):  # nobody has read for 4 kB: lost, as on a UART
                os.write(boards[number].master, frames[tick])
                written[number, tick] = stamp
            if tick % 5 == 0:
                boards[number].answer(tick)
        if stopped:
            break
    np.save(folder / "written.npy", written)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
