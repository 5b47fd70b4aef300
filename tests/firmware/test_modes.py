"""The table of modes in firmware/README.md, cell by cell, on both firmwares."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from gateway.emulator.firmware_model.output import OutputFault
from protocol.wire.messages import EventCode, Flag, Mode
from tests.harness.firmware.modes import MODES, Row, drawings, rows
from tests.harness.gateway.board_host import FIRMWARES, Bench, Host, skip_without_compiler

Action = Callable[[Host, Bench], object]
FULL_A, TOP_M = 5.0, 1.0


def lose_host(policy: int) -> Action:
    def act(host: Host, bench: Bench) -> None:
        host.request("SET_HOST_LOSS", policy=policy, timeout=50)
        host.run(30, alive=False)

    return act


def read(*, i_a: float | None = None, x_m: float | None = None, ticks: int) -> Action:
    def act(host: Host, bench: Bench) -> None:
        bench.i_a, bench.x_m = bench.i_a if i_a is None else i_a, bench.x_m if x_m is None else x_m
        host.run(ticks)

    return act


def set_mode(mode: Mode) -> Action:
    return lambda host, bench: host.request("SET_MODE", mode=mode)


def fail_writes(host: Host, bench: Bench) -> None:
    host.firmware.fail_output(OutputFault.DEAF)
    host.run(6)


def break_stack(host: Host, bench: Bench) -> None:
    host.firmware.break_stack()
    host.run(1)
    assert host.details(EventCode.STACK_FAULT) == [0]
    host.request("SET_MODE", mode=Mode.CLOSED_LOOP)  # no command ends it
    host.run(1)
    assert host.details(EventCode.STACK_FAULT) == [0, 0]


def reset(host: Host, bench: Bench) -> None:
    host.firmware.reset(EventCode.RESET_WATCHDOG)
    host.run(20)


ACTIONS: dict[str, Action] = {
    **{f"SET_MODE {name}": set_mode(mode) for name, mode in MODES.items()},
    "STOP": lambda host, bench: host.request("STOP"),
    "host lost, policy keep": lose_host(0),
    "host lost, policy coil off": lose_host(1),
    "host lost, policy hold": lose_host(2),
    "i_c at its top for 50 ticks": read(i_a=FULL_A, ticks=51),
    "x at an end for 500 ticks": read(x_m=TOP_M, ticks=501),
    "5 writes of u_c not confirmed": fail_writes,
    "the end of the stack overwritten": break_stack,
    "a reset": reset,
}


def state(host: Host) -> tuple[Mode, bool]:
    """The mode in force, and whether a fault is."""
    flags = host.run(1)[-1].flags
    return Mode(flags & 3), bool(flags & Flag.FAULT)


@pytest.mark.parametrize("kind", FIRMWARES)
@pytest.mark.parametrize("before", Mode, ids=lambda mode: mode.name)
@pytest.mark.parametrize("row", rows(), ids=lambda row: re.sub(r"\W+", "_", row.event))
def test_the_cell_says_what_the_board_does(row: Row, before: Mode, kind: str) -> None:
    if kind == "c":
        skip_without_compiler()
    bench = Bench()
    host = Host(bench, board=FIRMWARES[kind](bench))
    host.request("SET_HOST_LOSS", policy=0, timeout=60000)
    host.request("SET_MODE", mode=before)

    ACTIONS[row.event](host, bench)

    mode, fault = state(host)
    assert mode == row.after[before]
    assert fault == (row.fault == "begins" or row.fault == f"begins in {before.name.lower().replace('_', ' ')}")


@pytest.mark.parametrize("kind", FIRMWARES)
@pytest.mark.parametrize(
    "row", [row for row in rows() if row.fault in ("ends", "stays")], ids=lambda row: re.sub(r"\W+", "_", row.event)
)
def test_a_fault_ends_or_stays_as_the_row_says(row: Row, kind: str) -> None:
    if kind == "c":
        skip_without_compiler()
    bench = Bench(i_a=FULL_A)
    host = Host(bench, board=FIRMWARES[kind](bench))
    host.run(60)
    bench.i_a = 0.0
    assert state(host) == (Mode.IDLE, True)

    ACTIONS[row.event](host, bench)

    assert state(host)[1] == (row.fault == "stays")


def test_the_drawings_are_those_of_the_table() -> None:
    """Else: python -m tests.harness.firmware.modes."""
    assert {file.name: file.read_text(encoding="utf-8") for file in drawings()} == {
        file.name: drawing for file, drawing in drawings().items()
    }
