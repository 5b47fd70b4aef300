"""Runs emulated boards in real time, faster, or as fast as possible; in this thread or a separate one.

    with Emulator(boards=2, effects={"quadratic-drag": 1.0}) as emulator:
        gateway.open(emulator.urls[0])     # socket://127.0.0.1:PORT
        emulator.inject("stall=0.5")

Rule 1: deadlines are absolute: tick k of every board is due at start + k * T_s / speed.  Late ticks are counted and
        made up for, so the boards' clocks never drift from the wall clock.  A delay of up to a tenth of a second is
        made up at once, a longer one at twice the speed.  At once, a host would have no time to answer, and its boards
        would report it as lost.
Rule 2: one thread runs all boards; other threads schedule actions in it (`call`).
Rule 3: with speed 0 there are no deadlines.  Time stands still until a host is connected, and a slow host slows the
        boards instead of losing bytes.
Rule 4: in lockstep time passes only in `advance`.  Bytes that the host wrote before arrive at the first tick.  Bytes
        that it does not read in between are lost once the port's buffer is full.
"""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Self, TypedDict, Unpack

from gateway.emulator.faults import Fault, parse
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.flash import CE152_BOARD, T_S_US, BoardProfile
from gateway.emulator.firmware_model.magnetoshield import magnetoshield
from gateway.emulator.line import Board, BoardLine, LineCounts
from gateway.emulator.own_rig import load_rig
from gateway.emulator.plant.levitation import EmulatedPlant
from gateway.emulator.plant.magnetoshield import EmulatedMagnetoShield
from gateway.emulator.ports import EmulatedPort, pty_ports, tcp_ports
from gateway.emulator.wiring import FaultyWiring
from protocol.errors import ServiceError, UsageError

_T_NS = T_S_US * 1000
_BURST = 50  # ticks made up for at once at most
_CATCH_UP = 2.0  # times the speed, where more is late
_PATIENCE_S = 1.0  # speed 0: how long a host may leave its buffer full before bytes are lost

RIGS: Mapping[str, tuple[type[EmulatedPlant], BoardProfile]] = {  # a plant, and the board that controls it
    "ce152": (EmulatedPlant, CE152_BOARD),
    "magnetoshield": (EmulatedMagnetoShield, magnetoshield()),
}


class BoardOptions(TypedDict, total=False):
    """The options of the boards of an emulator."""

    effects: Mapping[str, float]  # strengths by name (none)
    faults: Iterable[str | Fault]  # as given to --fault, or parsed (none)
    seed: int  # of noise and faults; board n has seed + n (0)
    baud: int  # bits per second (115200)
    board_id: int  # of the first board; the others count up (1)
    # Makes a board: the model (default), the core in C (`native`), or a chip (`firmware.sim`).
    firmware: Callable[..., Board]
    rig: str  # plant and board: one of `RIGS`, or the file of an own one, `own_rig.py` (ce152)


class Server:
    """Runs boards until `stop`, a duration or an error.

    Args:
        lines: The boards; closed at the end of `run`.
        speed: Times faster than real time; 0: as fast as possible, without a duration only while a host is connected;
            None: in lockstep, by `call` alone.
        latency_timer_s: Time of the boards for which an adapter collects bytes; each tick sends at once if it is
            shorter than that.
    """

    def __init__(self, lines: list[BoardLine], *, speed: float | None = 1.0, latency_timer_s: float = 0.0) -> None:
        self.lines = lines
        self.overdue_ticks = 0
        self.worst_lateness_s = 0.0
        self._speed = speed
        self._collected_ticks = round(latency_timer_s * 1_000_000 / T_S_US)
        self._calls: SimpleQueue[Callable[[], object]] = SimpleQueue()  # a signal handler may put
        self._stopped = False

    def stop(self) -> None:
        """End `run` soon; from any thread or signal handler."""
        self._stopped = True
        self.call(lambda: None)

    def call(self, action: Callable[[], object]) -> None:
        """Run `action` between two ticks, in the thread that runs the boards."""
        self._calls.put(action)

    def run(self, duration_s: float | None = None) -> None:
        """Run the boards, for `duration_s` of their time or until `stop`; then close their ports."""
        ticks = None if duration_s is None else round(duration_s * 1_000_000 / T_S_US)
        try:
            if self._speed is None:
                while not self._stopped:
                    self._rest(None)
            elif self._speed > 0:
                self._run_in_time(ticks, self._speed)
            else:
                self._run_flat_out(ticks)
        finally:
            for line in self.lines:
                line.close()

    def _run_in_time(self, ticks: int | None, speed: float) -> None:
        period_ns = _T_NS / speed
        # A host reads once in a tick of real time, or once for each packet of the adapter.
        together = max(1, min(max(int(speed), self._collected_ticks), _BURST))
        start_ns = time.monotonic_ns()
        ticks_run, allowed, before_ns = 0, 0.0, start_ns
        while not self._stopped and ticks_run != ticks:
            now_ns = time.monotonic_ns()
            allowed = min(allowed + _CATCH_UP * (now_ns - before_ns) / period_ns, _BURST)
            before_ns = now_ns
            behind_ns = now_ns - start_ns - int((ticks_run + together) * period_ns)
            early_ns = max(-behind_ns, (together - allowed) * period_ns / _CATCH_UP)
            self._rest(max(early_ns, 0.0) * 1e-9)
            if early_ns > 0:
                continue
            due = together + int(behind_ns / period_ns)
            now = min(due, int(allowed), ticks - ticks_run if ticks is not None else due)
            allowed -= now
            if due > together:
                self.overdue_ticks += min(due - together, now)
                self.worst_lateness_s = max(self.worst_lateness_s, behind_ns * 1e-9)
            for line in self.lines:
                line.step(now)
            ticks_run += now

    def _run_flat_out(self, ticks: int | None) -> None:
        ticks_run = 0
        while not self._stopped and ticks_run != ticks:
            # Without an end it would run for ever ahead of a host that is still to come.
            if ticks is None and not any(line.port.connected() for line in self.lines):
                self._rest(0.005)
                continue
            self._rest(0.0)
            for _ in range(_BURST if ticks is None else min(_BURST, ticks - ticks_run)):
                for line in self.lines:
                    line.step(wait_s=_PATIENCE_S)
                ticks_run += 1

    def _rest(self, timeout_s: float | None) -> None:
        """Sleep until the next deadline, or do what other threads asked for."""
        # Not `get` with a timeout: after a signal, CPython's queue may wait for ever (seen with 3.11 under load).
        if timeout_s is None:
            self._calls.get()()
        else:
            time.sleep(timeout_s)
        with contextlib.suppress(Empty):
            while True:
                self._calls.get_nowait()()


class Emulator:
    """The boards served by a thread of their own, for tests and demonstrations.

    Args:
        boards: How many.
        tcp: On free TCP ports of 127.0.0.1; else on ptys.
        pty: With tcp false: path of the link (several boards: PATH-1, PATH-2, ...); None: in a temporary folder.
        speed: Times faster than real time; 0: as fast as possible.
        lockstep: Time passes in `advance` alone, for code that talks to the port itself: a gateway takes a board whose
            time stands for one that is silent.
        options: Of the boards.

    Raises:
        UsageError: the rig's board is not made for this chip.
        InstallError: the firmware in C or a chip, and a compiler or simulator for it is missing.
    """

    def __init__(
        self,
        *,
        boards: int = 1,
        tcp: bool = True,
        pty: Path | None = None,
        speed: float = 1.0,
        lockstep: bool = False,
        **options: Unpack[BoardOptions],
    ) -> None:
        self._folder = None
        if not tcp and pty is None:
            self._folder = tempfile.TemporaryDirectory(prefix="board51-")
            pty = Path(self._folder.name) / "board"
        ports = tcp_ports("127.0.0.1", 0, boards) if tcp or pty is None else pty_ports(pty, boards)
        self._server = Server(build_lines(ports, **options), speed=None if lockstep else speed)
        self._lockstep = lockstep
        self._thread = threading.Thread(target=self._server.run, name="emulator", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()
        self._thread.join(10.0)
        if self._folder is not None:
            self._folder.cleanup()

    @property
    def urls(self) -> list[str]:
        """The addresses of the ports for a gateway, one per board; a pty that came back renamed has a new one."""
        return [line.port.url for line in self._server.lines]

    @property
    def overdue_ticks(self) -> int:
        """The number of ticks that were not run in time."""
        return self._server.overdue_ticks

    def advance(self, duration_s: float) -> float:
        """Advance all boards by `duration_s` in lockstep; return their time since power-on, s.

        Raises:
            UsageError: the emulator runs by the clock.
            ServiceError: a host that is connected did not read, and has lost bytes: read more often, `advance` less.
        """
        if not self._lockstep:
            raise UsageError("This emulator runs by the clock", remedy="Make it with lockstep=True")
        lines, ticks = self._server.lines, round(duration_s * 1_000_000 / T_S_US)

        def work(_first: BoardLine) -> None:
            connected = [line for line in lines if line.port.connected()]
            lost = sum(line.counts.bytes_not_taken for line in connected)
            for _ in range(ticks):
                for line in lines:
                    line.step()
            lost = sum(line.counts.bytes_not_taken for line in connected) - lost
            if lost and all(line.port.connected() for line in connected):
                raise ServiceError(
                    f"The host has not read, and has lost {lost} bytes of the {duration_s:g} s",
                    remedy="Advance by 0.1 s at most, and read in between",
                )

        self._do(work, 0, patience_s=10.0 * (1.0 + duration_s))
        return lines[0].time_s

    def counts(self, board: int = 0) -> LineCounts:
        """Return the counters of a board's line."""
        return self._server.lines[board].counts

    def inject(self, fault: str | Fault, board: int = 0) -> None:
        """Add a fault whose START counts from now; it is in force on return."""
        parsed = parse(fault) if isinstance(fault, str) else fault
        self._do(lambda line: line.inject(parsed), board)

    def reset_board(self, board: int = 0) -> None:
        """Interrupt the board's power for a moment."""
        self._do(BoardLine.power_cycle, board)

    def disconnect(self, board: int = 0) -> None:
        """Disconnect the line until `reconnect`."""
        self._do(BoardLine.disconnect, board)

    def reconnect(self, board: int = 0, *, renamed: bool = False) -> None:
        """Connect the line again; a pty under another name if `renamed`."""
        self._do(lambda line: line.reconnect(renamed=renamed), board)

    def _do(self, action: Callable[[BoardLine], None], board: int, *, patience_s: float = 10.0) -> None:
        line, outcome = self._server.lines[board], Future[None]()

        def work() -> None:
            try:
                action(line)
                outcome.set_result(None)
            except Exception as error:  # handed to the caller below
                outcome.set_exception(error)

        self._server.call(work)
        try:
            outcome.result(patience_s)
        except TimeoutError:
            problem = "The emulator's thread does not answer"
            raise ServiceError(problem, remedy="Use it inside its `with` block") from None


def rig_of(name: str) -> tuple[Callable[..., EmulatedPlant], BoardProfile]:
    """Return the maker of the plant and the board of a rig of `RIGS`, or of the file of an own one.

    Raises:
        ConfigError, DataError: of `load_rig`.
    """
    if name in RIGS:
        return RIGS[name]
    rig, profile = load_rig(Path(name))
    return partial(EmulatedPlant, rig), profile


def build_lines(ports: Iterable[EmulatedPort], **options: Unpack[BoardOptions]) -> list[BoardLine]:
    """Create a board with its own plant for each port; either all ports are opened or none.

    Raises:
        UsageError: an effect or fault is unknown; a pty path is in use; a chip does not give the baud rate, or the
            rig's board is not made for it.
        InstallError: a compiler or simulator is needed and missing.
        ServiceError: a TCP port is in use, or the compiler fails.
    """
    parsed = [parse(fault) if isinstance(fault, str) else fault for fault in options.get("faults", ())]
    seed, baud, first_id = options.get("seed", 0), options.get("baud", 115200), options.get("board_id", 1)
    make, (plant_of, profile) = options.get("firmware", Firmware), rig_of(options.get("rig", "ce152"))
    lines: list[BoardLine] = []
    try:
        for n, port in enumerate(ports):
            plant = FaultyWiring(plant_of(effects=options.get("effects", {}), seed=seed + n), profile, seed=seed + n)
            board = make(plant, board_id=first_id + n, profile=profile)
            lines.append(BoardLine(board, port, baud=baud, faults=parsed, seed=seed + n, wiring=plant))
    except BaseException:
        for line in lines:
            line.close()
        raise
    return lines
