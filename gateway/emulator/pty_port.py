"""A pty as a port of the emulator; only Linux and macOS have one, so it is imported only if needed."""

from __future__ import annotations

import os
import select
import termios
import tty
from functools import partial
from pathlib import Path

from gateway.emulator.ports import write_now
from protocol.errors import UsageError


class PtyPort:
    """A pseudo-terminal behind a symbolic link.

    Args:
        link: Path of the link; removed at `close` if it is still ours.
    """

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
            raise UsageError(
                f"Link {self._link} cannot be made: {error.strerror}",
                remedy="Give --pty a path that is free in a folder you can write to",
            ) from error

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
