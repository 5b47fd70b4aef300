"""A line to a chip on which one frame follows the other without a gap, and what becomes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.emulator.firmware_model.flash import T_S_US
from protocol.wire.messages import EventCode, Value
from tests.harness.firmware.chip_host import ChipBoard, ChipHost
from tests.harness.gateway.board_host import frame

DRAIN_TICKS = 140  # ticks after which all that waits has been answered
BITS = 10  # of a byte


@dataclass(frozen=True, slots=True)
class Fate:
    """The fates of the frames of a full line."""

    sent: int
    answered: int
    counted: int  # in bad_frames
    overruns: int  # events
    overloads: int
    states: int
    ticks: int


def fill_line(
    host: ChipHost[ChipBoard], name: str, fields: Mapping[str, Value], *, ticks: int = 150, baud: int = 115200
) -> Fate:
    """Send one command after the other for some ticks, then let the board finish."""
    board, credit, sent = host.board, 0.0, 0
    messages, states, bad, first = len(host.messages), len(host.states), board.bad_frames, board.next_tick
    for _ in range(ticks):
        credit += baud * T_S_US * 1e-6 / BITS
        while credit > 0:
            sent += 1
            data = frame(name, id=1 + sent % 255, **fields)
            board.feed(data)
            credit -= len(data)
        host.run()
    host.run(DRAIN_TICKS)
    got = host.messages[messages:]
    codes = [EventCode(message.int("code")) for message in got if message.name == "EVENT"]
    return Fate(
        sent=sent,
        answered=len(got) - len(codes),
        counted=board.bad_frames - bad,
        overruns=codes.count(EventCode.OVERRUN),
        overloads=codes.count(EventCode.OVERLOAD),
        states=len(host.states) - states,
        ticks=board.next_tick - first,
    )
