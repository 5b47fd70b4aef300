"""Tests of both chips at a full line: ticks are in time, and each frame is answered or counted.

The table of firmware/README.md has what `-s` prints here.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from firmware.sim.avr.board import CYCLES_PER_TICK, AvrBoard
from firmware.sim.mcs51.board import TICK_CYCLES, Mcs51Board
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.messages import EventCode, Value
from tests.firmware.test_mcs51_image import COMMANDS
from tests.firmware.test_shared_variables import step_to
from tests.harness.firmware.avr_bench import AvrHost, skip_without_avr
from tests.harness.firmware.chip_host import ChipHost
from tests.harness.firmware.full_line import Fate, fill_line
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench

MAX_TICK_SHARE = 0.95  # cycles awake; moves with when in a tick the frames end, and that with the length of the boot
MAX_TURN_SHARE = 0.8  # of the main loop
MAX_DELAY = 0.05  # of the first conversion of a tick
CASES = [(name, fields) for name, fields in COMMANDS if name != "CAPTURE"]
IDS = [f"{name}-{fields.get('shape', '')}".strip("-") for name, fields in CASES]


class Watched(EmulatedPlant):
    """Notes the cycle of each conversion of i_c that begins a tick."""

    def __init__(self) -> None:
        super().__init__(seed=1)
        self.now: Callable[[], int] = int
        self.begun: list[int] = []

    def sense(self) -> tuple[float, float]:
        self.begun.append(self.now())
        return super().sense()

    def latest(self, period: int) -> float:
        """Return how long after the earliest tick the latest began, in periods; the position follows the current."""
        phases = [(cycle - self.begun[0] + period // 2) % period for cycle in self.begun[::2]]
        return (max(phases) - min(phases)) / period


def check(fate: Fate, name: str) -> None:
    assert fate.sent == fate.answered + fate.counted, fate
    assert fate.states >= fate.ticks - 3, fate  # those of the last ticks are on their way
    assert fate.overruns == 0
    assert fate.answered > 30
    assert fate.overloads == 1 or name in ("SET_GAINS", "EXCITE")


@pytest.mark.parametrize(("name", "fields"), CASES, ids=IDS)
def test_the_8051_keeps_its_ticks(name: str, fields: dict[str, Value]) -> None:
    skip_without_sdcc()
    plant = Watched()
    board = Mcs51Board(plant)
    plant.now = lambda: int(board.chip.cpu.cycles)
    host = ChipHost(board)
    host.run(40)
    host.hello()
    if name == "READ_CAPTURE":
        host.request("SET_MODE", mode=1)
        host.request("CAPTURE", u_from=300, u_to=1700, pre=40, count=240)
        host.until(EventCode.CAPTURE_DONE)
    else:
        host.request("SET_MODE", mode=2)
    host.run(60)
    plant.begun.clear()
    board.chip.longest_turn = 0

    fate = fill_line(host, name, fields)

    turn, delay = board.chip.longest_turn / TICK_CYCLES, plant.latest(TICK_CYCLES)
    print(f"| {name} {fields.get('shape', '')} | {100 * turn:.0f} % | {100 * delay:.1f} % | {fate} |")
    check(fate, name)
    assert board.chip.lost_bytes == 0
    assert turn < MAX_TURN_SHARE
    assert delay < MAX_DELAY


@pytest.mark.parametrize("capture", [False, True], ids=["", "capture"])
@pytest.mark.parametrize(("name", "fields"), CASES, ids=IDS)
def test_the_avr_keeps_its_ticks(name: str, fields: dict[str, Value], *, capture: bool) -> None:
    skip_without_avr()
    plant = Watched()
    board = AvrBoard(plant)
    plant.now = lambda: board.cycle
    host = AvrHost(board)
    host.run(5)
    host.hello()
    host.request("SET_MODE", mode=1 if capture else 2)
    if capture:
        host.request("CAPTURE", u_from=300, u_to=1700, pre=50, count=200)
    host.run(2)
    begun = len(host.cycles)
    plant.begun.clear()

    fate = fill_line(host, name, fields, ticks=30 if capture else 150)

    share = max(host.cycles[begun:]) / CYCLES_PER_TICK
    delay = plant.latest(CYCLES_PER_TICK)
    print(
        f"| {name} {fields.get('shape', '')} {'in a capture' * capture} | {100 * share:.0f} % | {100 * delay:.1f} % |"
    )
    if capture:
        assert fate.sent == fate.answered + fate.counted, fate
        assert fate.overruns == 0
    else:
        check(fate, name)
        assert delay < MAX_DELAY
    assert share < MAX_TICK_SHARE


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fields"), CASES, ids=IDS)
def test_the_avr_keeps_its_ticks_at_250000_where_bytes_come_faster_than_it_can_look_at_them(
    name: str, fields: dict[str, Value]
) -> None:
    skip_without_avr()
    plant = Watched()
    board = AvrBoard(plant, baud=250000)
    plant.now = lambda: board.cycle
    host = AvrHost(board)
    host.run(5)
    host.hello()
    host.request("SET_MODE", mode=2)
    plant.begun.clear()

    fate = fill_line(host, name, fields, baud=250000)

    print(f"| {name} {fields.get('shape', '')} | {100 * plant.latest(CYCLES_PER_TICK):.1f} % | {fate} |")
    assert plant.latest(CYCLES_PER_TICK) < 0.08  # a STOP is not put off
    assert fate.states >= fate.ticks - 3
    assert fate.overruns == 0
    assert fate.answered + fate.counted > 0.7 * fate.sent  # two frames that ran into each other count as one


def test_a_tick_that_takes_longer_than_its_time_is_reported() -> None:
    """It begins in time, and ends when the next one is due: that one is run, so that none is missing."""
    skip_without_sdcc()
    host = ChipHost(Mcs51Board(Bench()))
    host.run(40)
    step_to(host.board, "b51_loop_run")
    host.board.chip.held_until = host.board.chip.cpu.cycles + int(1.1 * TICK_CYCLES)

    host.until(EventCode.OVERRUN)
    host.run(3)
    flagged = [state for state in host.states if state.flags & 0x20]

    assert len(flagged) == 1
    sequences = [state.sequence for state in host.states]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
