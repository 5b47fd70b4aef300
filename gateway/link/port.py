"""Opens a pyserial URL as a non-blocking file descriptor, or reports why that is not possible.

A tty, a pty and socket:// have a descriptor of their own.  For other handlers (rfc2217://, loop://, spy://) two threads
copy the bytes through a socket pair, so that the serial thread can wait for descriptors only.

`open_port` may block for seconds (TCP, a stuck driver): never call it in the serial thread.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import io
import os
import socket
import stat
import termios
import threading
from dataclasses import dataclass

import serial

from protocol.errors import ConfigError

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
        self._pair: socket.socket | None = None
        try:
            self.fd = int(device.fileno())
        except (io.UnsupportedOperation, AttributeError):
            self.fd = self._pump()
        os.set_blocking(self.fd, False)

    def read(self) -> bytes | None:
        """Return the bytes that have arrived; None if there are none, b"" if the port is lost."""
        try:
            return os.read(self.fd, READ_SIZE)
        except BlockingIOError:
            return None
        except OSError:  # EIO: the pty's other end closed, the USB adapter was pulled
            return b""

    def write(self, data: bytes) -> int | None:
        """Write without blocking; return the number of accepted bytes, or None if the port is lost."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0
        except OSError:
            return None

    def close(self) -> None:
        """Close the port; never raises."""
        with contextlib.suppress(OSError, termios.error, serial.SerialException):
            if self._pair is not None:
                self._pair.close()
            self._device.close()

    def _pump(self) -> int:
        local, remote = socket.socketpair()
        self._pair = local
        self._device.timeout = 0.05
        threading.Thread(target=_from_device, args=(self._device, remote), name="port-read", daemon=True).start()
        threading.Thread(target=_to_device, args=(self._device, remote), name="port-write", daemon=True).start()
        return local.fileno()


def _from_device(device: serial.SerialBase, end: socket.socket) -> None:
    try:
        while True:
            # One byte, then the rest: a read of more would wait for its time-out before it returns what has come.
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


def open_port(url: str, baud: int) -> Port | PortProblem:
    """Open `url`; for a path with *, ? or [, open the first match that can be opened."""
    names = [url]
    if "://" not in url and _GLOB & set(url):
        names = sorted(glob.glob(url))
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
    if "://" not in name:
        try:
            if not stat.S_ISCHR(os.stat(name).st_mode):
                return PortProblem("port-failed", f"{name} is not a serial device.")
        except OSError:
            return PortProblem("port-absent", f"There is no {name}: is the adapter plugged in?")
    try:
        # exclusive: an flock, so that a second gateway on this port is refused instead of stealing every other byte.
        device = serial.serial_for_url(name, baudrate=baud, timeout=0, exclusive=True)
    except (OSError, ValueError, termios.error) as error:  # SerialException is an OSError
        return _problem(name, baud, error)
    _tune(device)
    try:
        return Port(device, name)
    except OSError as error:
        device.close()
        return _problem(name, baud, error)


def _problem(name: str, baud: int, error: Exception) -> PortProblem:
    number = error.errno if isinstance(error, OSError) else None
    text = str(error)
    if "exclusively lock" in text or number in (errno.EBUSY, errno.EAGAIN):
        return PortProblem(
            "port-busy", f"{name} is in use by another program, perhaps a second gateway: end one of the two."
        )
    if number in (errno.EACCES, errno.EPERM):
        return PortProblem(
            "port-permission",
            f"No permission to open {name}: add the user to its group (sudo usermod -aG dialout $USER). Log in again.",
        )
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return PortProblem("port-absent", f"There is no {name}: is the adapter plugged in?")
    if name.startswith("socket://"):
        return PortProblem("port-absent", f"No answer from {name}: is the serial server running?")
    return PortProblem("port-failed", f"{name} cannot be opened at {baud} bit/s: {text}.")


def _tune(device: serial.SerialBase) -> None:
    """Reduce latency, and prevent a reset of the board when the port closes; a device may ignore each setting."""
    try:
        fd = int(device.fileno())
        is_socket = stat.S_ISSOCK(os.fstat(fd).st_mode)
    except (OSError, AttributeError):
        return
    if is_socket:
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(fd)) as copy:
            copy.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if hasattr(socket, "TCP_USER_TIMEOUT"):
                copy.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _USER_TIMEOUT_MS)
        return
    with contextlib.suppress(termios.error):
        attributes = termios.tcgetattr(fd)
        attributes[2] &= ~termios.HUPCL  # closing must not drop DTR: on many boards that is the reset line
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
    # An FTDI adapter collects bytes for 16 ms unless told otherwise.
    if isinstance(device, serial.Serial):
        with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):
            device.set_low_latency_mode(True)
