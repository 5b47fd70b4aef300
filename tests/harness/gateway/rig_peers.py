"""An emulated board, its gateway and its page, as processes; and a network between page and browser that can fail."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gateway.processes.command import ADAPTER
from tests.harness.gateway.hmi_peers import Process, hmi
from tests.harness.ports import free_port


class Rig:
    """Emulated board, gateway and page as processes that can be taken away and come back."""

    def __init__(self, folder: Path, emulator: Process, stack: ExitStack, *, config: Path | None = None) -> None:
        self.folder, self.emulator, self._stack = folder, emulator, stack
        self._config = () if config is None else ("--config", str(config))
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.gateway = self.start_gateway()
        self.hmi = self.start_hmi()

    def start_gateway(self) -> Process:
        words = ("--board", f"rig={self.folder / 'tty'}", "--listen", self.endpoint)
        process = Process(self.folder, "gateway", *words, *self._config, "--log-dir", str(self.folder / "logs"))
        self._stack.enter_context(process)
        process.wait_for_words("streaming")
        return process

    def start_hmi(self) -> Process:
        _, process = self._stack.enter_context(hmi(self.folder, self.endpoint, port=self.port))
        return process


@contextmanager
def emulated_rig(folder: Path, *emulator: str, config: Path | None = None) -> Iterator[Rig]:
    """All of it, ready.

    Args:
        folder: For everything that is written.
        emulator: Options of the emulator.
        config: Of the gateway; its board is named `rig`.
    """
    with ExitStack() as stack:
        process = stack.enter_context(Process(folder, "emulate", "--pty", str(folder / "tty"), *ADAPTER, *emulator))
        process.wait_for_words("tty")
        yield Rig(folder, process, stack, config=config)


class Network:
    """TCP between a browser and a page's server: it can hold everything up, or the answers to some requests."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._open, self._answers = threading.Event(), threading.Event()
        self._lost: list[threading.Event] = []
        self._open.set()
        self._answers.set()
        self._held = b""
        self._sockets: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._run(self._accept)

    def __enter__(self) -> Network:
        return self

    def __exit__(self, *_: object) -> None:
        for gate in (self._open, self._answers, *self._lost):
            gate.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.reset()
        for thread in self._threads:
            thread.join(10.0)

    def cut(self) -> None:
        """Let nothing pass, without a sign of it, as when a phone sleeps or a cable is pulled."""
        self._open.clear()

    def restore(self) -> None:
        """Let everything that was held up go on its way."""
        self._open.set()

    def lose(self) -> None:
        """Restore the network, but let nothing ever pass over the earlier connections.

        Whoever had them on a list has forgotten them.
        """
        self._lost.append(self._open)
        self._open = threading.Event()
        self._open.set()

    def reset(self) -> None:
        """Connections end."""
        for connection in self._sockets:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()
        self._sockets.clear()

    def hold_answers(self, to: bytes) -> None:
        """Hold answers up from now on, on connections whose requests have `to` in them."""
        self._held = to
        self._answers.clear()

    def release_answers(self) -> None:
        """They go on their way."""
        self._answers.set()

    def _run(self, work: object, *args: object) -> None:
        thread = threading.Thread(target=work, args=args, daemon=True)  # type: ignore[arg-type]  # any of ours
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
                server = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                if self._listener.fileno() < 0:
                    return
                client.close()  # the server is away
                continue
            self._sockets += [client, server]
            requested, gate = threading.Event(), self._open
            self._run(self._pump, client, server, requested, gate, True)
            self._run(self._pump, server, client, requested, gate, False)

    def _pump(
        self, source: socket.socket, sink: socket.socket, requested: threading.Event, gate: threading.Event, forth: bool
    ) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if forth and self._held and self._held in data:
                    requested.set()
                if not forth and requested.is_set():
                    self._answers.wait()
                gate.wait()
                sink.sendall(data)
        gate.wait()  # the end of a connection is news, too
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_WR)
