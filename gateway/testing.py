"""A pytest plugin: an emulated board, and a gateway in front of it, for tests of your own SCADA or control code.

It comes with the installation (entry point `pytest11`); a test asks for a fixture by its name:

    def test_my_display_shows_a_fault(board51_gateway):
        gateway = board51_gateway(effects={"quadratic-drag": 1.0}, opcua=True)
        display = MyDisplay(gateway.opcua_url)
        gateway.emulators[0].reset_board()
        assert display.await_event("reset-power-on")

    board51_emulator    boards on ptys or TCP ports: effects, link faults, in real time, faster, or in lockstep
    board51_gateway     `board51 gateway` as a process on free ports of 127.0.0.1; OPC UA and web page if asked for

Rule 1: what a test does not ask for costs nothing: this file imports only pytest and the standard library.
Rule 2: everything ends with the test, whatever became of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import pytest

if TYPE_CHECKING:
    import subprocess

    from gateway.client.rig import Rig
    from gateway.emulator.serve import Emulator

__all__ = ["EmulatorFactory", "GatewayFactory", "RunningGateway"]


class EmulatorFactory(Protocol):
    """The fixture `board51_emulator`; a test may call it several times."""

    def __call__(
        self,
        *,
        port: Literal["tcp", "pty"] = "tcp",
        boards: int = 1,
        effects: Mapping[str, float] = ...,
        faults: Iterable[str] = (),
        lockstep: bool = False,
        speed: float = 1.0,
        seed: int = 0,
        baud: int = 115200,
    ) -> Emulator:
        """Start boards that run until the test ends.

        Args:
            port: On free TCP ports of 127.0.0.1, or on ptys.
            boards: How many.
            effects: What the rig does beyond the model, by name: `board51 emulate --help` lists them with their units.
            faults: What goes wrong on the line, as for `board51 emulate --fault`; `.inject(...)` adds one later.
            lockstep: The boards' time passes in `.advance(duration_s)` alone; for code that talks to the port itself.
            speed: Of the boards' time, times faster than real time; 0: as fast as possible.
            seed: Of noise and faults.
            baud: Of the line, bit/s.

        Returns:
            The running boards; `.urls` are pyserial URLs, one for each.

        Raises:
            UsageError: an unknown effect or fault.
        """


class GatewayFactory:
    """The fixture `board51_gateway`; a test may call it several times."""

    def __init__(self, running: ExitStack, start_boards: EmulatorFactory, folders: pytest.TempPathFactory) -> None:
        self._running, self._start_boards, self._folders = running, start_boards, folders

    def __call__(
        self,
        *emulators: Emulator,
        opcua: bool = False,
        hmi: bool = False,
        log: bool = True,
        config: str = "",
        **emulator: Any,
    ) -> RunningGateway:
        """Start a gateway, and wait until samples come.

        Args:
            emulators: Whose boards it serves, as rig1, rig2, ...; none: one of its own, made of `emulator`.
            opcua: Serve OPC UA, too.
            hmi: Serve the web page, too.
            log: Write an MCAP log.
            config: TOML, as for `board51 gateway --config`; no boards, no endpoints.
            emulator: Arguments for `board51_emulator`.

        Returns:
            The running gateway.

        Raises:
            ServiceError: it ended, or no samples came; says where its messages are.
        """
        behind = list(emulators) or [self._start_boards(**emulator)]
        folder = self._folders.mktemp("board51-gateway")
        gateway = RunningGateway(folder, behind, opcua=opcua, hmi=hmi, log=log, config=config)
        self._running.callback(gateway.stop)
        gateway.start()
        return gateway


class RunningGateway:
    """A `board51 gateway` process.

    Attributes:
        endpoint: Of its bus: tcp/127.0.0.1:PORT.
        boards: Names of the boards.
        emulators: Which are behind it.
        folder: Of its messages (gateway.log) and, below `logs`, of its MCAP log.
        opcua_url: opc.tcp://127.0.0.1:PORT, or "".
        hmi_url: http://127.0.0.1:PORT, or "".
    """

    def __init__(
        self, folder: Path, emulators: list[Emulator], *, opcua: bool, hmi: bool, log: bool, config: str
    ) -> None:
        from gateway.processes.command import free_port

        self.folder, self.emulators = folder, emulators
        urls = [url for emulator in emulators for url in emulator.urls]
        self.boards = [f"rig{n}" for n in range(1, len(urls) + 1)]
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        (folder / "gateway.toml").write_text(config, encoding="utf-8")
        self._words = ["--config", str(folder / "gateway.toml"), "--listen", self.endpoint]
        self._words += [f"--board={name}={url}" for name, url in zip(self.boards, urls, strict=True)]
        self._words += ["--log-dir", str(folder / "logs")] if log else ["--no-log"]
        self.opcua_url = self.hmi_url = ""
        if opcua:
            address = f"127.0.0.1:{free_port()}"
            self.opcua_url, self._words = f"opc.tcp://{address}", [*self._words, "--opcua", address]
        if hmi:
            address = f"127.0.0.1:{free_port()}"
            self.hmi_url, self._words = f"http://{address}", [*self._words, "--hmi", address]
        self._process: subprocess.Popen[bytes] | None = None
        self._running = ExitStack()

    def start(self) -> None:
        """Start it, again on the same ports, and wait until every board streams and every view listens.

        Raises:
            ServiceError: it ended, or they did not within 90 s.
        """
        from gateway.processes.command import listens, running, wait

        self._process = self._running.enter_context(running(self.folder, "gateway", *self._words))
        for view in (self.opcua_url, self.hmi_url):
            if view:
                wait(partial(listens, int(view.rpartition(":")[2])), self._process, view)
        for board in self.boards:
            wait(partial(self._streams, board), self._process, board)

    def stop(self) -> None:
        """End it in good order, as SIGTERM does: its log is complete then."""
        self._running.close()

    def kill(self) -> None:
        """Let it die at once, as a crash or `kill -9` does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._running.close()

    def rig(self, board: str = "rig1", **options: Any) -> Rig:
        """A client for a board: `with gateway.rig() as rig:`; options as of `gateway.client.Rig`."""
        from gateway.client.rig import Rig

        return Rig(board, connect=self.endpoint, **options)

    def _streams(self, board: str) -> bool:
        from protocol.errors import ServiceError

        try:
            with self.rig(board) as rig, rig.samples(timeout_s=1.0) as samples:
                next(samples)
        except ServiceError:
            return False
        return True


@pytest.fixture
def board51_emulator() -> Iterator[EmulatorFactory]:
    """Emulated boards on ptys or TCP ports, with effects and link faults; see `EmulatorFactory`."""
    with ExitStack() as stack:
        yield _emulators(stack)


@pytest.fixture
def board51_gateway(
    board51_emulator: EmulatorFactory, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[GatewayFactory]:
    """A gateway with emulated boards behind it, on free ports; see `GatewayFactory`."""
    with ExitStack() as running:
        yield GatewayFactory(running, board51_emulator, tmp_path_factory)


def _emulators(stack: ExitStack) -> Callable[..., Emulator]:
    def start(*, port: Literal["tcp", "pty"] = "tcp", **options: Any) -> Emulator:
        from gateway.emulator.serve import Emulator

        return stack.enter_context(Emulator(tcp=port == "tcp", **options))

    return start
