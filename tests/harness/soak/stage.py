"""The stage of a soak: emulated boards in this process, two gateways on one router, subscribers, a twin, disks."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import MappingProxyType

from gateway.emulator.faults import parse
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.line import BoardLine
from gateway.emulator.ports import PtyPort
from gateway.emulator.serve import Server, build_lines
from protocol.wire.messages import Mode
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port
from tests.harness.soak.names import PLANT
from tests.harness.soak.numbered_board import Ledger, LedgerPort, NumberedBoard
from tests.harness.soak.processes import Service, looked_at
from tests.harness.soak.wall_clock import WallClock
from tests.patience import HANG_S

GATEWAYS = 2
_ROOM = 1 << 34  # bytes that a disk may take, of memory
_CONFIG = """
[zenoh]
mode = "client"
connect = ["{endpoint}"]
[log]
directory = "{logs}"
rotate_s = 60.0
queue = {queue}
min_free_bytes = 0
"""
_BOARD = """
[[board]]
name = "{name}"
port = "{port}*"
reconnect_s = 0.05
stale_s = 0.3
"""


class Disk:
    """A file system in memory that can be made full; without the right to mount, a folder that cannot."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        words = ["mount", "-t", "tmpfs", "-o", f"size={_ROOM}", "tmpfs", str(folder)]
        self.mounted = subprocess.run(words, capture_output=True, check=False).returncode == 0

    def fill(self, *, leave: int = 65536) -> None:
        """Leave no room but for one or two chunks, or for less."""
        used = sum(file.stat().st_size for file in self.folder.iterdir())
        self._resize(used + leave)

    def free(self) -> None:
        """Give the room back."""
        self._resize(_ROOM)

    def close(self) -> None:
        """Unmount it."""
        if self.mounted:
            subprocess.run(["umount", "-l", str(self.folder)], check=True)

    def _resize(self, size: int) -> None:
        subprocess.run(["mount", "-o", f"remount,size={size}", str(self.folder)], check=False, capture_output=True)


class Stage:
    """All of it.  The first gateway is the one that dies; the other runs from begin to end.

    Args:
        folder: For everything that is written.
        boards: How many; every other one is served by the first gateway.
        seed: Of the faults of the lines.
        log_queue: Messages that may wait for the disk.
        plant: One more board, with a ball, on which campaigns run; the other gateway serves it.
    """

    def __init__(self, folder: Path, boards: int, seed: int, log_queue: int, *, plant: bool) -> None:
        self.folder = folder
        self.ledgers = [Ledger() for _ in range(boards)]
        self.lines = []
        for n, ledger in enumerate(self.ledgers):
            port = LedgerPort(PtyPort(folder / f"tty{n:02d}-"), ledger)
            self.lines.append(BoardLine(NumberedBoard(ledger, board_id=n + 1), port, seed=seed + n))
        self.plant = build_lines([PtyPort(folder / "plant-")], board_id=boards + 1)[0] if plant else None
        self.parked: list[tuple[str, bool, bool]] = []  # who, what it said, what is
        self._server = Server([*self.lines, self.plant] if self.plant else self.lines)
        self._thread = threading.Thread(target=self._server.run)
        self.endpoint, self.published = f"tcp/127.0.0.1:{free_port()}", folder / "published.npy"
        module = ("-m", "tests.harness.soak.witness", self.endpoint)
        self.router = Service(
            "router", folder, "-m", "board51", "router", "--listen", self.endpoint, ready="listens on"
        )
        self.witness = Service("witness", folder, *module, str(self.published), ready="ready")
        self.slow = Service("slow", folder, *module, "--slow", ready="ready")
        self.stopped = Service("stopped", folder, *module, "--slow", ready="ready")
        self.twin = self._command("twin", "twin", "--no-names")
        self.hand_over, self.replay = self._command("hand-over", "twin"), self._command("replay", "replay")
        self.disks = [Disk(folder / f"disk{n}") for n in range(GATEWAYS)]
        self.clocks = [WallClock(folder, f"gateway{n}") for n in range(GATEWAYS)]
        self.gateways = [self._gateway(n, log_queue) for n in range(GATEWAYS)]
        # They are on the host of their gateway, so its clock is theirs.
        campaign, its_clock = ("campaign", "run", "--board", PLANT, "--quick", "--park"), self.clocks[-1].environment
        self.campaign = self._command("campaign", *campaign, environment=its_clock)
        self.stop = self._command("stop", "send", PLANT, "stop", environment=its_clock)

    @property
    def services(self) -> list[Service]:
        """The processes, in the order of their start."""
        return [self.router, self.witness, self.slow, self.stopped, *self.gateways, self.twin]

    @property
    def errands(self) -> list[Service]:
        """The processes that come and go."""
        return [self.hand_over, self.replay, self.campaign, self.stop]

    def logs(self, gateway: int) -> list[Path]:
        """The parts of a gateway's log in their order, but for one that was killed before its first flush."""
        return sorted(part for part in self.disks[gateway].folder.glob("*.mcap") if part.stat().st_size)

    def do(self, line: BoardLine, action: Callable[[BoardLine], None]) -> None:
        """Let something happen to a board, between two of its ticks; it has happened on return."""
        finished = threading.Event()

        def act() -> None:
            action(line)
            finished.set()

        self._server.call(act)
        assert finished.wait(HANG_S), "the emulator's thread has ended"

    def note_parked(self, who: str, *, reported: bool) -> None:
        """Note whether the board with a ball is idle and its coil off, and whether `who` has said so."""
        assert self.plant is not None
        board = self.plant.firmware
        assert isinstance(board, Firmware)
        self.do(self.plant, lambda _: self.parked.append((who, reported, board.mode == Mode.IDLE and board.u == 0)))

    def inject(self, board: int, fault: str) -> None:
        """Let a fault of the line begin now."""
        self.do(self.lines[board], lambda line: line.inject(parse(fault)))

    def run_boards(self) -> None:
        """Switch the boards on."""
        self._thread.start()

    def end(self) -> None:
        """End everything in good order: what is under way arrives.

        Raises:
            AssertionError: a gateway, or the twin, ends with another exit code than 0.
        """
        self._server.stop()
        self._thread.join(HANG_S)
        time.sleep(1.0)  # the last bytes are read
        for errand in self.errands:
            errand.kill()
        wait_for(lambda: "twin of model" in self.twin.output, "twin")  # it may have been started a moment ago
        assert self.twin.end() == 0
        assert [gateway.end() for gateway in self.gateways] == [0] * GATEWAYS
        time.sleep(1.0)
        assert self.witness.end() == 0

    def close(self) -> None:
        """Release all of it, whatever became of the test."""
        self._server.stop()
        if self._thread.ident is not None:
            self._thread.join(HANG_S)
        for line in self._server.lines:
            line.close()
        for disk in self.disks:
            disk.close()

    def _command(self, name: str, *words: str, environment: Mapping[str, str] = MappingProxyType({})) -> Service:
        every = ("-m", "board51", *words, "--connect", self.endpoint)
        return Service(name, self.folder, *every, environment=environment)

    def _gateway(self, n: int, log_queue: int) -> Service:
        boards = "".join(
            _BOARD.format(name=f"rig{board}", port=self.folder / f"tty{board:02d}-")
            for board in range(len(self.lines))
            if board % GATEWAYS == n
        )
        if self.plant and n == GATEWAYS - 1:
            boards += _BOARD.format(name=PLANT, port=self.plant.port.url)
        config = self.folder / f"gateway{n}.toml"
        text = _CONFIG.format(endpoint=self.endpoint, logs=self.disks[n].folder, queue=log_queue)
        config.write_text(boards + text, encoding="utf-8")
        words = ("-m", "board51", "gateway", "--config", str(config))
        return Service(f"gateway{n}", self.folder, *words, environment=self.clocks[n].environment)


@contextmanager
def staged(folder: Path, *, boards: int, seed: int, log_queue: int, plant: bool) -> Iterator[Stage]:
    """Everything runs, the boards last, so that a sample's way is open before there is one."""
    with ExitStack() as stack:
        stage = Stage(folder, boards, seed, log_queue, plant=plant)
        stack.callback(stage.close)
        stack.enter_context(looked_at([*stage.services, *stage.errands]))
        for service in stage.services:
            service.start()
        wait_for(lambda: all(map(stage.logs, range(GATEWAYS))), "the logs of the gateways")
        stage.run_boards()
        yield stage
