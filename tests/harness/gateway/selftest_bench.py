"""The self-test of an emulated board in the emulator's own time: no port, no thread, no clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from gateway.emulator.firmware_model.flash import T_S_US
from gateway.emulator.line import Board, BoardLine
from gateway.emulator.serve import build_lines
from gateway.selftest.bench import Bench
from gateway.selftest.connection import Connection
from gateway.selftest.rigs import RIGS
from gateway.selftest.runner import run_checks, switch_off
from gateway.selftest.table import CHECKS
from gateway.selftest.verdict import Result, Verdict

_T_S = T_S_US * 1e-6


class MemoryPort:
    """A port of the emulator whose bytes stay in memory."""

    url = "memory"

    def __init__(self) -> None:
        self.to_host, self.to_board = bytearray(), bytearray()
        self.present = False

    def open(self, *, renamed: bool = False) -> None:
        self.present = True

    def close(self) -> None:
        self.present = False

    def connected(self) -> bool:
        return self.present

    def read(self, limit: int) -> bytes:
        data = bytes(self.to_board[:limit])
        del self.to_board[:limit]
        return data

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        self.to_host += data
        return len(data)


class VirtualWire:
    """A `Wire` whose time passes while it waits: the board runs a tick, as often as it takes."""

    def __init__(self, line: BoardLine, port: MemoryPort, *, each_tick: Callable[[BoardLine], None] | None) -> None:
        self._line, self._port, self._each_tick = line, port, each_tick
        self._ticks = 0

    def now_s(self) -> float:
        return self._ticks * _T_S

    def wait(self, timeout_s: float) -> bool:
        end_s = self.now_s() + timeout_s
        while True:
            self._line.step()
            self._ticks += 1
            if self._each_tick is not None:
                self._each_tick(self._line)
            if self._port.to_host or not self._port.present:
                return True
            if self.now_s() >= end_s:
                return False

    def read(self) -> bytes | None:
        if not self._port.present:
            return b""
        data = bytes(self._port.to_host)
        self._port.to_host.clear()
        return data or None

    def write(self, data: bytes) -> int | None:
        if not self._port.present:
            return None
        self._port.to_board += data
        return len(data)

    def close(self) -> None:
        self._port.close()


def selftest(
    rig: str = "ce152",
    *,
    names: Sequence[str] = (),
    quick: bool = True,
    effects: Mapping[str, float] | None = None,
    faults: Iterable[str] = (),
    firmware: Callable[..., Board] | None = None,
    numbers: str = "",
    seed: int = 0,
    prepare: Callable[[BoardLine], None] = lambda _line: None,
    each_tick: Callable[[BoardLine], None] | None = None,
) -> list[Verdict]:
    """Return the verdicts on one emulated board, the one on its coil last; `numbers` is another rig to judge it by."""
    bench = virtual_bench(
        rig,
        quick=quick,
        effects=effects or {},
        faults=faults,
        firmware=firmware,
        numbers=numbers,
        seed=seed,
        prepare=prepare,
        each_tick=each_tick,
    )
    verdicts = list(run_checks(bench, [check for check in CHECKS if not names or check.name in names]))
    return [*verdicts, switch_off(bench)]


def virtual_bench(
    rig: str = "ce152",
    *,
    quick: bool = True,
    effects: Mapping[str, float] | None = None,
    faults: Iterable[str] = (),
    firmware: Callable[..., Board] | None = None,
    numbers: str = "",
    seed: int = 0,
    prepare: Callable[[BoardLine], None] = lambda _line: None,
    each_tick: Callable[[BoardLine], None] | None = None,
) -> Bench:
    """Return the bench of one emulated board that was not called yet."""
    port = MemoryPort()
    options: dict[str, Any] = {} if firmware is None else {"firmware": firmware}
    (line,) = build_lines([port], rig=rig, effects=effects or {}, faults=faults, seed=seed, **options)
    prepare(line)
    wire = VirtualWire(line, port, each_tick=each_tick)
    return Bench(line=Connection(wire), rig=RIGS[numbers or rig], quick=quick)


def names_of(verdicts: Iterable[Verdict], *results: Result) -> list[str]:
    return [verdict.name for verdict in verdicts if verdict.result in results]
