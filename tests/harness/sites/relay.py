"""A line between two sites, on loopback, that can be cut and mended: a relay of TCP connections."""

from __future__ import annotations

import socket
import threading
from types import TracebackType
from typing import Self

from tests.harness.ports import free_port


class Relay:
    """Listens on a free port and passes bytes on to `target`, while it is not cut."""

    def __init__(self, target: str) -> None:
        host, _, port = target.rpartition("/")[2].rpartition(":")
        self._target = host, int(port)
        self._port = free_port()
        self._lock = threading.Lock()
        self._open: list[socket.socket] = []
        self._listener: socket.socket | None = None

    @property
    def endpoint(self) -> str:
        """The address to connect to instead of the target."""
        return f"tcp/127.0.0.1:{self._port}"

    def __enter__(self) -> Self:
        self.mend()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cut()

    def mend(self) -> None:
        """Let connections through."""
        listener = socket.create_server(("127.0.0.1", self._port))
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def cut(self) -> None:
        """End all connections, and refuse new ones."""
        with self._lock:
            listener, self._listener = self._listener, None
            ended, self._open = self._open, []
        for end in [*ended, *([listener] if listener else [])]:
            _end(end)

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                client, _ = listener.accept()
                server = socket.create_connection(self._target)
            except OSError:
                return
            with self._lock:
                if self._listener is not listener:
                    _end(client)
                    _end(server)
                    return
                self._open += [client, server]
            for source, sink in ((client, server), (server, client)):
                threading.Thread(target=self._pass_on, args=(source, sink), daemon=True).start()

    def _pass_on(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while (data := source.recv(65536)) and self._passes(len(data)):
                sink.sendall(data)
        except OSError:
            pass
        _end(source)
        _end(sink)

    def _passes(self, size: int) -> bool:
        return True


class StallingRelay(Relay):
    """Passes `limit` bytes on, in both directions together; then it holds whatever comes, until it is cut."""

    def __init__(self, target: str, limit: int) -> None:
        super().__init__(target)
        self.stalled, self._ended = threading.Event(), threading.Event()
        self._left = limit

    def cut(self) -> None:
        self._ended.set()
        super().cut()

    def _passes(self, size: int) -> bool:
        with self._lock:
            self._left -= size
            if self._left >= 0:
                return True
        self.stalled.set()
        self._ended.wait()
        return False


def _end(end: socket.socket) -> None:
    try:
        end.shutdown(socket.SHUT_RDWR)
    except OSError:  # it is not connected, or ended already
        pass
    end.close()
