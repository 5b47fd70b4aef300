"""Opens a pyserial URL as a non-blocking file descriptor, or reports why that is not possible.

A tty, a pty and socket:// have a descriptor of their own.  For other handlers (rfc2217://, loop://, spy://) and the COM
ports of Windows two threads copy the bytes through a socket pair, so that the serial thread can wait for descriptors
only.

`open_port` may block for seconds (TCP, a stuck driver): never call it in the serial thread.
"""

from __future__ import annotations

import contextlib
import errno
import fnmatch
import glob
import io
import os
import socket
import stat
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import serial

from protocol.errors import ConfigError

try:
    import termios

    TtyError: type[Exception] = termios.error
except ModuleNotFoundError:  # Windows
    TtyError = OSError

_READ_S = 0.05  # how often the thread of a port without a descriptor checks whether the port was closed
_PUMP_ENDS_S = 1.0
_USER_TIMEOUT_MS = 5000  # a TCP connection without acknowledgement for this long is lost: no power or network
READ_SIZE = 65536
_GLOB = frozenset("*?[")


@dataclass(frozen=True, slots=True)
class PortProblem:
    """The reason why a port cannot be opened.  `kind` is kebab-case and stable; `text` says what to do."""

    kind: str  # port-absent | port-permission | port-busy | port-failed
    text: str


class Port:
    """An open port."""

    def __init__(self, device: serial.SerialBase, name: str) -> None:
        self.name = name
        self._device = device
        self._pumps: list[threading.Thread] = []
        self._receive: Callable[[], bytes]
        self._send: Callable[[bytes], int]
        self._end = self._socket()
        if self._end is None:
            self.fd = int(device.fileno())
            os.set_blocking(self.fd, False)
            self._receive, self._send = partial(os.read, self.fd, READ_SIZE), partial(os.write, self.fd)
        else:  # on Windows os.read and os.write take no socket
            self.fd = self._end.fileno()
            self._end.setblocking(False)
            self._receive, self._send = partial(self._end.recv, READ_SIZE), self._end.send

    def read(self) -> bytes | None:
        """Return the bytes that have arrived; None if there are none, b"" if the port is lost."""
        try:
            return self._receive()
        except BlockingIOError:
            return None
        except OSError:  # EIO: the pty's other end closed, the USB adapter was pulled
            return b""

    def write(self, data: bytes) -> int | None:
        """Write without blocking; return the number of accepted bytes, or None if the port is lost."""
        try:
            return self._send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return None

    def close(self) -> None:
        """Close the port; never raises."""
        own = vars(self._device).get("_socket")
        with contextlib.suppress(OSError, TtyError, serial.SerialException):
            if self._end is not None:
                self._end.close()
            self._device.close()
        if own is not None:
            own.close()  # pyserial does not where the peer has gone first: its shutdown then fails
        # A read that has not ended holds the port: whoever opens it next would find it in use.
        for pump in self._pumps:
            pump.join(_PUMP_ENDS_S)

    def _socket(self) -> socket.socket | None:
        """Return the socket of a device that has one or is pumped; None for a tty."""
        try:
            fd = int(self._device.fileno())
        except (io.UnsupportedOperation, AttributeError):
            return self._pump()
        if not self.name.startswith("socket://"):
            return None
        end = socket.fromfd(fd, socket.AF_INET, socket.SOCK_STREAM)  # a duplicate: pyserial closes its own
        with contextlib.suppress(OSError):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if hasattr(socket, "TCP_USER_TIMEOUT"):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _USER_TIMEOUT_MS)
        return end

    def _pump(self) -> socket.socket:
        local, remote = socket.socketpair()
        self._device.timeout = _READ_S
        for name, work in (("port-read", _from_device), ("port-write", _to_device)):
            pump = threading.Thread(target=work, args=(self._device, remote), name=name, daemon=True)
            pump.start()
            self._pumps.append(pump)
        return local


def _from_device(device: serial.SerialBase, end: socket.socket) -> None:
    try:
        while True:
            # One byte, then the rest: a read of more bytes would wait for its time-out before it returns.
            data = device.read(1)
            if data:
                end.sendall(bytes(data) + bytes(device.read(getattr(device, "in_waiting", 0))))
    except (OSError, serial.SerialException, TypeError, AttributeError):  # TypeError: closed by the other thread
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def _to_device(device: serial.SerialBase, end: socket.socket) -> None:
    with contextlib.suppress(OSError, serial.SerialException, TypeError, AttributeError):
        while data := end.recv(READ_SIZE):
            device.write(data)
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)
    end.close()


def check_url(url: str) -> None:
    """Refuse a URL that can never be opened.

    Raises:
        ConfigError: the kind of URL is unknown, or the URL is malformed.
    """
    if "://" not in url:
        return
    try:
        serial.serial_for_url(url, do_not_open=True)
    except (ValueError, serial.SerialException) as error:
        raise ConfigError(
            f"port {url!r}: {error}", remedy="Give a device such as /dev/ttyUSB0, or socket://host:port"
        ) from None
    if url.startswith("socket://") and not _has_tcp_port(url):
        raise ConfigError(f"port {url!r} is not a socket URL", remedy="Write it as socket://host:port")


def _has_tcp_port(url: str) -> bool:
    host, _, port = url.removeprefix("socket://").split("?")[0].rstrip("/").rpartition(":")
    return bool(host) and port.isdigit() and 0 < int(port) < 65536


def closed_problem(url: str) -> PortProblem | None:
    """Return why a port could not be opened, as far as that is known without opening, which may reset the board."""
    if "://" in url or os.name != "posix":
        return None
    names = glob.glob(url) if _GLOB & set(url) else [url]
    present = [name for name in names if os.path.exists(name)]
    if not present:
        return _absent(url)
    return None if any(os.access(name, os.R_OK | os.W_OK) for name in present) else _forbidden(url)


def open_port(url: str, baud: int) -> Port | PortProblem:
    """Open `url`; for a path with *, ? or [, open the first match that can be opened."""
    names = [url]
    if "://" not in url and _GLOB & set(url):
        names = sorted(glob.glob(url) if os.name == "posix" else fnmatch.filter(_com_ports(), url))
        if not names:
            return PortProblem("port-absent", f"No device matches {url}.")
    problem: Port | PortProblem = PortProblem("port-absent", f"There is no {url}.")
    # Not only the first match: another program may use it.
    for name in names:
        problem = _open_port(name, baud)
        if isinstance(problem, Port):
            break
    return problem


def _open_port(name: str, baud: int) -> Port | PortProblem:
    if "://" not in name and os.name == "posix":  # COM3 is not a file
        try:
            if not stat.S_ISCHR(os.stat(name).st_mode):
                return PortProblem("port-failed", f"{name} is not a serial device.")
        except OSError:
            return _absent(name)
    try:
        # exclusive: an flock, so that a second gateway on this port is refused instead of stealing every other byte.
        device = serial.serial_for_url(name, baudrate=baud, timeout=0, exclusive=True)
    except (OSError, ValueError, TtyError) as error:  # SerialException is an OSError
        return _problem(name, baud, error)
    _tune_tty(device)
    try:
        return Port(device, name)
    except OSError as error:
        device.close()
        return _problem(name, baud, error)


def _problem(name: str, baud: int, error: Exception) -> PortProblem:
    number = error.errno if isinstance(error, OSError) else None
    text = str(error)
    # On Windows pyserial gives no number, only the name of an exception; a port in use is one without permission.
    if "exclusively lock" in text or "PermissionError" in text or number in (errno.EBUSY, errno.EAGAIN):
        return PortProblem(
            "port-busy", f"{name} is in use by another program, perhaps a second gateway: end one of the two."
        )
    if number in (errno.EACCES, errno.EPERM):
        return _forbidden(name)
    if "FileNotFoundError" in text or number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return _absent(name)
    if name.startswith("socket://"):
        return PortProblem("port-absent", f"No answer from {name}: is the serial server running?")
    return PortProblem("port-failed", f"{name} cannot be opened at {baud} bit/s: {text}.")


def _absent(name: str) -> PortProblem:
    return PortProblem("port-absent", f"There is no {name}: is the adapter plugged in?")


def _forbidden(name: str) -> PortProblem:
    return PortProblem(
        "port-permission",
        f"No permission to open {name}: add the user to its group (sudo usermod -aG dialout $USER). Log in again.",
    )


def _com_ports() -> list[str]:
    from serial.tools.list_ports import comports

    return [port.device for port in comports()]


def _tune_tty(device: serial.SerialBase) -> None:
    """Reduce latency, and prevent a reset of the board when the port closes; a device may ignore each setting."""
    if TtyError is OSError or not isinstance(device, serial.Serial):
        return
    with contextlib.suppress(OSError, TtyError):
        fd = int(device.fileno())
        attributes = termios.tcgetattr(fd)
        attributes[2] &= ~termios.HUPCL  # closing must not drop DTR: on many boards that is the reset line
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
    # An FTDI adapter collects bytes for 16 ms unless told otherwise.
    with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):
        device.set_low_latency_mode(True)
