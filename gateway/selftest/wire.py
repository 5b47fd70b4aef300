"""The serial port and the clock as the self-test sees them."""

from __future__ import annotations

import select
import time
from typing import Protocol

from gateway.link.port import Port, PortProblem, check_url, open_port
from protocol.errors import UsageError


class Wire(Protocol):
    """Bytes of one board, and the time by which they come."""

    def now_s(self) -> float:
        """Return the time, s; only differences matter."""

    def wait(self, timeout_s: float) -> bool:
        """Return whether there are bytes to read within `timeout_s`, or the port is lost."""

    def read(self) -> bytes | None:
        """Return the bytes after a `wait` that said yes; b"" if the port is lost."""

    def write(self, data: bytes) -> int | None:
        """Write without blocking; return the number of accepted bytes, or None if the port is lost."""

    def close(self) -> None:
        """Close it; never raises."""


class SerialWire:
    """An open port by the host's clock."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.read, self.write, self.close, self.now_s = port.read, port.write, port.close, time.monotonic

    def wait(self, timeout_s: float) -> bool:
        """Return whether there are bytes to read within `timeout_s`, or the port is lost."""
        return bool(select.select([self._port.fd], [], [], max(timeout_s, 0.0))[0])


def open_wire(port: str, baud: int) -> SerialWire:
    """Open a device, a pty, or tcp://HOST:PORT.

    Raises:
        UsageError: the port cannot be opened; says why.
        ConfigError: no URL of pyserial's.
    """
    url = "socket://" + port.removeprefix("tcp://") if port.startswith("tcp://") else port
    check_url(url)
    opened = open_port(url, baud)
    if isinstance(opened, PortProblem):
        problem = opened.text.rstrip(".?")
        raise UsageError(problem, remedy="Give the board's port; `ls /dev/ttyACM* /dev/ttyUSB*` lists them")
    return SerialWire(opened)
