"""The main loop and an interrupt change the same variables: no instruction of one may fall between two of the other.

A variable that an interrupt writes is written by the main loop with interrupts off, or in one instruction; if it has
more than a byte, it is read with interrupts off, too.  What does otherwise stands here with its reason.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from firmware.sim.avr.board import AvrBoard
from firmware.sim.mcs51.board import TICK_CYCLES, Mcs51Board
from firmware.sim.mcs51.build import simulator
from firmware.sim.mcs51.library import load
from tests.harness.firmware.avr_bench import skip_without_avr
from tests.harness.firmware.chip_host import ChipBoard, ChipHost
from tests.harness.firmware.machine_code import Access, Program, avr_program, mcs51_program
from tests.harness.firmware.mcs51_bench import skip_without_sdcc
from tests.harness.gateway.board_host import Bench

OF_THE_CAPTURE = {"b51_capture_start", "leave"}  # before its timer starts and after it has ended
AVR_ALLOWED = {
    ("rest", "woken"),  # cleared after the sleep: the turn that begins then looks at everything
    ("b51_hal_capture_timer", "capture_waits"),  # its interrupt is off
    ("b51_hal_capture_timer", "capturing"),
    ("b51_hal_capture_timer", "register 0x70"),  # TIMSK2: a byte is set, whatever it was
    ("b51_hal_send", "register 0xc1"),  # UCSR0B: the interrupt clears only what is set here, when it has sent all
    ("stop_message", "register 0xbc"),  # TWCR: a capture that is running has the bus to itself
    ("step", "register 0xbc"),
    ("free_bus", "register 0xbc"),
    ("put", "register 0xbb"),  # TWDR, likewise
    ("read_stored", "register 0xbb"),  # before interrupts are admitted
    ("b51_hal_capture_timer", "register 0xb2"),  # TCNT2, its interrupt off
    ("start", "register 0x7a"),  # ADCSRA and UCSR0B, before interrupts are admitted
    ("start", "register 0xc1"),
}


def both_write(program: Program, roots: set[str]) -> tuple[set[str], set[tuple[str, str]]]:
    """The variables that an interrupt writes and the main loop touches, and its accesses that are not safe."""
    interrupt = program.reached(roots)
    main = program.reached({"main"})
    written = {a.variable for a in program.accesses if a.function in interrupt and a.writes}
    touched = [a for a in program.accesses if a.function in main and a.variable in written]
    bad = {(a.function, a.variable) for a in touched if not a.guarded and (a.size > 1 or a.writes) and not a.is_atomic}
    bad |= {(a.function, a.variable) for a, b in pairwise(touched) if split(a, b) and b.variable in written}
    return {a.variable for a in touched}, {at for at in bad if at[0] not in OF_THE_CAPTURE}


def split(first: Access, other: Access) -> bool:
    """Return whether these are two bytes of a number in `board`, read with an interrupt possible in between."""
    if first.writes or other.writes or first.function != other.function or first.guarded:
        return False
    name, _, at = first.variable.partition("+")
    return name == "board" and other.variable == f"board+{int(at) + 1}"


def test_the_main_loop_of_the_8051_and_its_interrupts_do_not_undo_each_other(tmp_path: Path) -> None:
    skip_without_sdcc()
    shared, bad = both_write(mcs51_program(tmp_path), {"b51_on_time", "b51_on_line"})

    assert {"ticks_due", "until_tick", "capture_us", "received_in", "sent_out", "sending"} <= shared
    assert len([name for name in shared if name.startswith("board+")]) >= 5
    assert bad == set()


def test_the_main_loop_of_the_avr_and_its_interrupts_do_not_undo_each_other(tmp_path: Path) -> None:
    skip_without_avr()
    program = avr_program(tmp_path)
    shared, bad = both_write(program, {name for name in program.calls if name.startswith("__vector_")})

    assert {"ticks_due", "capture_waits", "woken", "rx_in", "tx_out"} <= shared
    assert len([name for name in shared if name.startswith("board+")]) >= 5
    assert bad - AVR_ALLOWED == set()


def host_of(board: ChipBoard) -> ChipHost[ChipBoard]:
    host = ChipHost(board)
    host.run(20)
    host.hello()
    return host


def count_ticks(host: ChipHost[ChipBoard]) -> tuple[int, int]:
    """The number of the next tick, and how many were late."""
    overruns = host.request("PING").int("overruns")
    return host.board.next_tick, overruns


@pytest.mark.parametrize(
    ("absent", "make"), [(skip_without_avr, AvrBoard), (skip_without_sdcc, Mcs51Board)], ids=["AVR", "8051"]
)
@pytest.mark.parametrize("ticks", [2, 3, 6])
def test_each_tick_that_was_not_run_is_an_overrun(
    absent: Callable[[], None], make: type[ChipBoard], ticks: int
) -> None:
    absent()
    host = host_of(make(Bench()))
    _, before = count_ticks(host)
    host.board.overrun(ticks)
    _, after = count_ticks(host)

    # The last one is run, late; it is one of them if it ends when the next is due.
    assert after - before in (ticks - 1, ticks)


def test_a_tick_that_comes_while_the_8051_takes_one_is_not_lost() -> None:
    """The interrupt comes at each cycle of `hal_tick_due`, while one tick is due."""
    skip_without_sdcc()
    board = Mcs51Board(Bench())
    host, chip = host_of(board), board.chip
    due = cycle_of_tick(board)
    board.tick()  # the line goes on where the chip is
    board.tick()
    gains: set[int] = set()
    for ahead in range(80):
        run, overruns = count_ticks(host)
        begun = (chip.cpu.cycles - due) // TICK_CYCLES
        step_to(board, "b51_hal_tick_due")
        latest = due + (chip.cpu.cycles - due) // TICK_CYCLES * TICK_CYCLES
        chip.held_until = latest + 2 * TICK_CYCLES - ahead
        host.run(6)
        run_then, overruns_then = count_ticks(host)
        gains.add(run_then - run + overruns_then - overruns - ((chip.cpu.cycles - due) // TICK_CYCLES - begun))

    # 0: both were due, one was run, the other counted.  1: both were run, and the first ended when the other was due.
    assert gains == {0, 1}


def step_to(board: Mcs51Board, function: str) -> None:
    """Run the chip to this function, an instruction at a time."""
    chip, address, run = board.chip, board.symbols[function], load(simulator()).chip_run
    while chip.cpu.pc != address:
        run(chip, chip.cpu.cycles + 1)


def cycle_of_tick(board: Mcs51Board) -> int:
    """The cycle of an interrupt that makes a tick due: its loop begins with a conversion."""
    converts, run = 1, load(simulator()).chip_run
    while True:
        step_to(board, "b51_on_time")
        cycle = int(board.chip.cpu.cycles)
        if run(board.chip, cycle + 700) == converts:
            return cycle
