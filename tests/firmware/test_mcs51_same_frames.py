"""The image of the 8051 against the core on this machine: the same commands and readings give the same frames.

The two differ in time alone.  So a command ends well within a tick, and frames are compared queue by queue: which of
two queues has the line first is the UART's.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.native.build import compile_to
from gateway.emulator.native.flags import flags
from protocol.wire.messages import ROW_OF_NAME, ROWS
from tests.harness.firmware.mcs51_bench import (
    Readings,
    Sent,
    commands,
    first_look_us,
    play_to_chip,
    play_to_core,
    skip_without_sdcc,
)

TICKS = 3000


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The core as the image has it: its capture and its queues."""
    skip_without_sdcc()
    path: Path = tmp_path_factory.mktemp("core") / "core.so"
    compile_to(path, options=flags("MCS51_CONFIG"))
    return path


def both(seed: int, ticks: int, library: Path) -> tuple[Sent, Sent, Mcs51Board]:
    script = commands(seed, ticks)
    core_output, chip_output = Sent(), Sent()
    board = play_to_chip(Readings(seed, ticks + 10, first_look_us()), chip_output, script, ticks)
    play_to_core(NativeFirmware(Readings(seed, ticks + 10, 2000), path=library), core_output, script, ticks)
    return core_output, chip_output, board


def compared(core_output: Sent, chip_output: Sent) -> dict[str, tuple[int, int]]:
    """Return the number of frames of each queue, and the number of equal frames before the first that differs."""
    counts = {}
    for name, frames in chip_output.frames.items():
        pairs = list(zip(frames, core_output.frames[name], strict=False))
        counts[name] = (len(pairs), next((n for n, (a, b) in enumerate(pairs) if a != b), len(pairs)))
    return counts


@pytest.mark.slow
def test_six_seconds_of_anything_give_the_same_frames(library: Path) -> None:
    core_output, chip_output, board = both(1, TICKS, library)

    counts = compared(core_output, chip_output)
    assert all(same == pairs for pairs, same in counts.values()), counts
    assert counts["STATE"][0] > 0.5 * TICKS
    assert counts["answers"][0] >= TICKS // 12 - 4
    assert counts["EVENT"][0] > 50
    assert (board.dropped, board.bad_frames, board.chip.lost_bytes) == (0, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 6, *(pytest.param(n, marks=pytest.mark.sample) for n in (4, 5, 7, 8, 9, 10))])
def test_a_minute_of_anything_gives_the_same_frames(seed: int, library: Path) -> None:
    """3 and 6 reach every branch of the core that all of them reach (gcov)."""
    core_output, chip_output, _ = both(seed, 30_000, library)

    counts = compared(core_output, chip_output)
    assert all(same == pairs for pairs, same in counts.values()), counts
    answers = {body[0] for body in chip_output.frames["answers"]}
    assert answers == {row.type for row in ROWS if not row.to_board} - {
        ROW_OF_NAME[name].type
        for name in (
            "STATE",
            "EVENT",
            "CAPTURE_BLOCK",
            "HEALTH",
            "CALIBRATION",
        )  # what the last two say is the chip's own
    }
