"""Frames that are nearly right, for the parser alone: `python -m tests.harness.firmware.fuzz LIBRARY FRAMES SEED...`.

Each is a command, mutated before its CRC (so that it reaches fields and commands) or after (so that it reaches COBS and
CRC), at every length; the answers must be those of the model in Python.
"""

from __future__ import annotations

import random
import sys
from pathlib import Path

from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.native.board import NativeFirmware
from protocol.wire.codec import BODY_SIZE
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROWS
from tests.harness.firmware.random_host import Wandering
from tests.harness.protocol.port import take_output

COMMANDS = [row for row in ROWS if row.to_board]


def mutated(chance: random.Random, data: bytes) -> bytes:
    """Change, insert, remove or repeat bytes."""
    changed = bytearray(data)
    for _ in range(chance.randrange(1, 5)):
        at = chance.randrange(len(changed) + 1)
        match chance.randrange(4):
            case 0 if at < len(changed):
                changed[at] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256)))
            case 1:
                changed[at:at] = chance.randbytes(chance.choice((1, 2, 70)))
            case 2:
                del changed[at : at + chance.randrange(1, 4)]
            case _:
                changed[at:at] = changed[:at]
    return bytes(changed)


def command_like_frame(chance: random.Random) -> bytes:
    """A frame that is nearly a command."""
    row = chance.choice(COMMANDS)
    body = bytes((row.type, chance.randrange(256))) + chance.randbytes(BODY_SIZE[row.name] - 2)
    if chance.random() < 0.3:  # fields that are in range more often
        body = body[:2] + bytes(value if value < 3 else 0 for value in body[2:])
    if chance.random() < 0.4:
        body = mutated(chance, body)[: chance.choice((64, 64, 22, 3))] or b"\x02"
    data = encode_frame(body)
    return mutated(chance, data) if chance.random() < 0.4 else data


def fuzz(seed: int, frames: int, path: Path) -> int:
    """Feed both boards; return how many bytes came back.

    Raises:
        AssertionError: the answers differ.
    """
    chance = random.Random(seed)
    boards = Firmware(Wandering(seed)), NativeFirmware(Wandering(seed), path=path)
    count = 0
    for n in range(frames):
        data = command_like_frame(chance)
        for board in boards:
            board.feed(data)
        if n % 4 == 3:
            for board in boards:
                board.tick()
            python, c = (take_output(board) for board in boards)
            assert python == c, (seed, n, data.hex(" "), python.hex(" "), c.hex(" "))
            assert boards[0].bad_frames == boards[1].bad_frames, (seed, n, data.hex(" "))
            count += len(c)
    return count


if __name__ == "__main__":
    for argument in sys.argv[3:]:
        print(f"frames={sys.argv[2]} bytes={fuzz(int(argument), int(sys.argv[2]), Path(sys.argv[1]))}")
