"""Non-blocking ports of the emulator, for the host to connect to: a TCP port or a pty.

Rule 1: nothing here blocks, except `write` with a time limit.  A UART has no flow control: bytes that the host does not
        read are lost.
Rule 2: a port can be closed and opened again; a gateway opens it by its `url`.
Rule 3: a host may disconnect and reconnect; bytes sent in between are lost, as on a wire.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

from protocol.errors import ServiceError, UsageError

_SEND_BUFFER = 16384  # bytes; a stalled host must lose bytes, as on a serial line, and not read them minutes later


class EmulatedPort(Protocol):
    """A port: the host's connection to a board."""

    @property
    def url(self) -> str:
        """The URL for pyserial's `serial_for_url`."""

    def open(self, *, renamed: bool = False) -> None:
        """Open the port, under another name if `renamed` and supported."""

    def close(self) -> None:
        """Disconnect the host and close the port."""

    def connected(self) -> bool:
        """Return whether a host is connected."""

    def read(self, limit: int) -> bytes:
        """Return at most `limit` bytes that the host has sent."""

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        """Send bytes to the host; return the number of bytes accepted."""


class TcpPort:
    """A listening TCP socket for one host at a time; further connections are refused.

    Port 0 is a free one, the same again after `close` and `open`.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host = host
        self._port = port
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._reads = 0

    @property
    def url(self) -> str:
        """The address as socket://HOST:PORT."""
        return f"socket://{f'[{self._host}]' if ':' in self._host else self._host}:{self._port}"

    def open(self, *, renamed: bool = False) -> None:
        """Listen; a TCP port ignores `renamed`.

        Raises:
            ServiceError: the address is not of this machine, or the port is in use.
        """
        try:
            family = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM)[0][0]
            listener = socket.socket(family, socket.SOCK_STREAM)
            if os.name == "posix":  # on Windows a second server could take the port of the first with it
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((self._host, self._port))
                listener.listen(1)
            except OSError:
                listener.close()
                raise
        except OSError as error:
            raise ServiceError(
                f"TCP port {self._host}:{self._port} cannot be served: {error.strerror}",
                remedy="Give --tcp an address of this machine and a free port, or port 0",
            ) from error
        listener.setblocking(False)
        self._port = listener.getsockname()[1]
        self._listener = listener

    def close(self) -> None:
        """Disconnect the host and stop listening."""
        self._drop()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def connected(self) -> bool:
        """Return whether a host is connected; accepts a waiting one."""
        if self._client is None:
            self._client = self._accept()
        return self._client is not None

    def read(self, limit: int) -> bytes:
        """Return at most `limit` bytes."""
        self._reads += 1
        if self._client is not None and self._reads % 50 == 0:
            second = self._accept()
            if second is not None:
                second.close()
        if not self.connected() or self._client is None:
            return b""
        try:
            data = self._client.recv(limit)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        """Write to the host; return the number of bytes accepted, 0 without a host."""
        if self._client is None:
            return 0
        return write_now(self._client.send, self._client.fileno(), data, wait_s)

    def _accept(self) -> socket.socket | None:
        if self._listener is None:
            return None
        try:
            client, _ = self._listener.accept()
        except OSError:  # no connection waits, or it has ended already
            return None
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        return client

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


class PtyPort:
    """A pseudo-terminal behind a symbolic link, which is removed at `close` if it is still ours."""

    def __init__(self, link: Path) -> None:
        self._plain = link
        self._link = link
        self._master = -1
        self._target = ""
        self._present = False

    @property
    def url(self) -> str:
        """The path of the link."""
        return str(self._link)

    def open(self, *, renamed: bool = False) -> None:
        """Create a pty, and the link to it.

        Raises:
            UsageError: the path exists and is not a link, or its folder cannot be written.
        """
        import tty

        self._link = self._plain.with_name(self._plain.name + "-renamed") if renamed else self._plain
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._target = os.ttyname(slave)
        os.close(slave)  # from now on a read of the master shows whether a host has the slave open
        try:
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(self._target)
        except OSError as error:
            os.close(self._master)
            self._master = -1
            problem = f"Link {self._link} cannot be made: {error.strerror}"
            raise UsageError(problem, remedy="Give --pty a path that is free in a folder you can write to") from error

    def close(self) -> None:
        """Hang up: the host's next read ends, and the link is removed."""
        if self._master < 0:
            return
        if self._link.is_symlink() and os.readlink(self._link) == self._target:
            self._link.unlink()
        os.close(self._master)
        self._master = -1
        self._present = False

    def connected(self) -> bool:
        """Return whether a process has the slave open."""
        if self._master < 0:
            return False
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return not any(state & select.POLLHUP for _, state in poll.poll(0))

    def read(self, limit: int) -> bytes:
        """Return at most `limit` bytes."""
        if self._master < 0:
            return b""
        try:
            data = os.read(self._master, limit)
        except BlockingIOError:
            data = b""
        except OSError:  # EIO: no process has the slave open
            if self._present:
                self._present = False
                self._discard()
            return b""
        self._present = True
        return data

    def _discard(self) -> None:
        """Discard the bytes that the last host did not read: they are not for the next one."""
        import termios

        # The line keeps them while no host is there, and a flush of the master reaches only those on their way to it.
        termios.tcflush(self._master, termios.TCOFLUSH)
        slave = os.open(self._target, os.O_RDWR | os.O_NOCTTY)
        try:
            termios.tcflush(slave, termios.TCIFLUSH)
        finally:
            os.close(slave)

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        """Write to the host; return the number of bytes accepted, 0 without a host."""
        if self._master < 0 or not self._present:
            return 0
        return write_now(partial(os.write, self._master), self._master, data, wait_s)


def pty_ports(link: Path, boards: int) -> list[EmulatedPort]:
    """Return the ptys: PATH for one board, PATH-1, PATH-2, ... for several.

    Raises:
        UsageError: this system has no ptys.
    """
    if os.name != "posix":
        raise UsageError("A pty needs Linux or macOS", remedy="Give --tcp HOST:PORT instead")
    if boards == 1:
        return [PtyPort(link)]
    return [PtyPort(link.with_name(f"{link.name}-{n}")) for n in range(1, boards + 1)]


def tcp_ports(host: str, port: int, boards: int) -> list[EmulatedPort]:
    """Return consecutive TCP ports from `port` on, or free ones if it is 0."""
    return [TcpPort(host, port + n if port else 0) for n in range(boards)]


def write_now(send: Callable[[bytes], int], descriptor: int, data: bytes, wait_s: float) -> int:
    """Send what fits, and wait `wait_s` for room at most; return the number of bytes accepted."""
    written = 0
    with contextlib.suppress(OSError):  # a disconnected host is detected by the next read
        while written < len(data):
            try:
                written += send(data[written:])
            except BlockingIOError:
                if not wait_s or not select.select([], [descriptor], [], wait_s)[1]:
                    break
    return written
