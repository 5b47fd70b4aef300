"""Lets our modules find what Windows has, on a POSIX system: Python imports this at its start, see `windows()`.

Rule 1: only our own modules see it.  Python's library and numpy, zenoh, asyncio stay those of this system: under a
        false sys.platform they do not even start.
Rule 2: what Windows lacks is absent; what it refuses raises: a selector takes sockets only, `os.read` no socket.
Rule 3: a signal for another process ends it at once, but for Ctrl-Break, which SIGUSR1 plays.
"""

from __future__ import annotations

import builtins
import errno
import os
import select
import selectors
import signal
import stat
import subprocess
import sys
from types import ModuleType
from typing import Any

PACKAGES = {"board51", "firmware", "gateway", "protocol", "twin", "__main__"}
ABSENT_MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
ABSENT = {
    "os": "fork forkpty geteuid getgid getpgid getpriority getuid killpg nice openpty O_CLOEXEC O_NOCTTY O_NONBLOCK "
    "pread pwrite sched_setscheduler setpriority set_blocking setsid statvfs ttyname uname wait4",
    "select": "epoll poll",
    "signal": "ITIMER_REAL SIGALRM SIGCHLD SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGUSR1 SIGUSR2 alarm pause "
    "pthread_kill setitimer siginterrupt",
    "socket": "AF_UNIX TCP_USER_TIMEOUT",
}
GROUP = 0x200
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGABRT, signal.SIGUSR1)


class Module(ModuleType):
    """A module without what is absent, and with what differs."""

    def __init__(self, real: ModuleType, **different: Any) -> None:
        super().__init__(real.__name__)
        self.__dict__.update(different, _real=real, _absent=ABSENT.get(real.__name__, "").split())

    def __getattr__(self, name: str) -> Any:
        if name in self._absent:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} on Windows")
        return getattr(self._real, name)


def _is_socket(file: Any) -> bool:
    return stat.S_ISSOCK(os.fstat(file if isinstance(file, int) else file.fileno()).st_mode)


def _read(descriptor: int, count: int) -> bytes:
    if _is_socket(descriptor):
        raise OSError(errno.EBADF, "os.read takes no socket on Windows")
    return os.read(descriptor, count)


def _write(descriptor: int, data: bytes) -> int:
    if _is_socket(descriptor):
        raise OSError(errno.EBADF, "os.write takes no socket on Windows")
    return os.write(descriptor, data)


def _select(*lists: Any) -> Any:
    if not all(_is_socket(file) for files in lists[:3] for file in files):
        raise OSError(errno.ENOTSOCK, "select takes sockets only on Windows")
    return select.select(*lists)


class Selector(selectors.SelectSelector):
    """The only selector of Windows."""

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        """Register a socket."""
        if not _is_socket(fileobj):
            raise OSError(errno.ENOTSOCK, "a selector takes sockets only on Windows")
        return super().register(fileobj, events, data)


def _signal(number: int, handler: Any) -> Any:
    if number not in SIGNALS:
        raise ValueError(f"signal {number} is unknown to Windows")
    return signal.signal(number, handler)


def _kill(pid: int, _number: int) -> None:
    os.kill(pid, signal.SIGKILL)


class Popen(subprocess.Popen[Any]):
    """A process in a group of its own if so asked, that hears Ctrl-Break alone."""

    def __init__(self, *args: Any, creationflags: int = 0, **options: Any) -> None:
        assert not options.get("start_new_session"), "Windows has no sessions"
        assert not options.get("pass_fds"), "Windows passes no descriptors"
        super().__init__(*args, start_new_session=bool(creationflags & GROUP), **options)

    def send_signal(self, number: int) -> None:
        """Send Ctrl-Break, or end the process."""
        if number == signal.SIGINT:
            raise ValueError("Windows sends no SIGINT to another process")
        super().send_signal(signal.SIGUSR1 if number == signal.SIGUSR1 else signal.SIGKILL)


def _modules() -> dict[str, ModuleType]:
    import socket

    return {
        "os": Module(os, name="nt", read=_read, write=_write, kill=_kill),
        "select": Module(select, select=_select),
        "selectors": Module(selectors, DefaultSelector=Selector),
        "signal": Module(signal, SIGBREAK=signal.SIGUSR1, CTRL_BREAK_EVENT=signal.SIGUSR1, signal=_signal),
        "socket": Module(socket),
        "subprocess": Module(
            subprocess, Popen=Popen, CREATE_NEW_PROCESS_GROUP=GROUP, BELOW_NORMAL_PRIORITY_CLASS=0x4000
        ),
        "sys": Module(sys, platform="win32"),
    }


def _import(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
    if level == 0 and globals and str(globals.get("__name__")).partition(".")[0] in PACKAGES:
        root = name.partition(".")[0]
        if root in ABSENT_MODULES:
            raise ModuleNotFoundError(f"No module named {root!r} on Windows", name=root)
        if root in MODULES:
            return MODULES[root]
    return IMPORT(name, globals, locals, fromlist, level)


if __name__ == "sitecustomize":
    MODULES, IMPORT = _modules(), builtins.__import__
    builtins.__import__ = _import
