"""Views as child processes of the gateway: started with it, restarted when they die, ended with it.

Rule 1: a view's trouble is the view's: the gateway logs it and goes on.
Rule 2: what died is started again after 1 s, 2 s, ... at most 30 s; after a minute without trouble, from 1 s again.
Rule 3: exit code 2 is a wrong option or file, which another start does not mend: it stays ended.
Rule 4: what hangs is killed and started again: each view beats (child.py), and HUNG_S without a beat is a hang.
Rule 5: no view outlives the gateway, also not after kill -9 (see child.py).
"""

from __future__ import annotations

import logging
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gateway.access.folder import SecurityFolder
from gateway.access.listeners import check_listener, nearest
from gateway.config import GatewayConfig
from gateway.views.account import ACCOUNT
from gateway.views.child import BEAT_VARIABLE
from gateway.views.listen import address

FIRST_WAIT_S = 1.0
LONGEST_WAIT_S = 30.0
CALM_S = 60.0
END_S = 5.0  # to end by itself before it is killed
HUNG_S = 20.0  # far beyond what a busy machine keeps a process waiting
_USAGE = 2
_logger = logging.getLogger("gateway.views")


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A `board51` command to run."""

    name: str
    arguments: tuple[str, ...]


def views_for(config: GatewayConfig) -> list[View]:
    """The commands that serve the views of `config`, on its bus.

    Raises:
        ConfigError: an address that is none, or a view that would be open to the network without protection.
    """
    z = config.zenoh
    endpoints = z.listen if z.mode == "router" else z.connect
    bus: tuple[str, ...] = ("--connect", nearest(endpoints), "--site", config.site)
    insecure = ("--insecure",) if config.security.insecure else ()
    folder = SecurityFolder(Path(config.security.directory)) if config.security.directory else None
    if folder is not None:
        bus += ("--identity", str(folder.identity_path(ACCOUNT)))
    views: list[View] = []
    wanted = {"opcua": config.opcua.listen, "hmi": config.hmi.listen, "foxglove": config.foxglove.listen}
    for name, listen in wanted.items():
        if not listen:
            continue
        host, port = address(listen, where=f"--{name} or [{name}] listen:")
        guarded = folder is not None and name in ("opcua", "hmi")
        own: tuple[str, ...] = ("--security", config.security.directory) if guarded else ()
        shown = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        check_listener(
            host,
            protected=guarded,
            insecure=config.security.insecure,
            what=f"--{name} {shown}",
            remedy="Foxglove has no login: use an ssh tunnel" if name == "foxglove" else "Give --security DIR",
        )
        if name == "hmi" and config.log.enabled:
            own += ("--log-dir", config.log.directory)
        if name == "opcua":
            own += ("--rate", f"{config.opcua.rate_hz:g}", "--history", f"{config.opcua.history_s:g}")
        views.append(View(name=name, arguments=("--listen", shown, *bus, *own, *insecure)))
    return views


@contextmanager
def running(views: Sequence[View]) -> Iterator[None]:
    """Keep the views running within the block."""
    keepers = [_Keeper(view) for view in views]
    try:
        yield
    finally:
        for keeper in keepers:
            keeper.stop()
        for keeper in keepers:
            keeper.join()


class _Keeper:
    """Keeps one view running, in a thread of its own."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._stop = threading.Event()
        self._lock = threading.Lock()  # a stop must not slip between a look at it and a start
        self._process: subprocess.Popen[bytes] | None = None
        self._beats = -1  # read end of its pipe
        self._thread = threading.Thread(target=self._work, name=f"view-{view.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ask it to end."""
        with self._lock:
            self._stop.set()
            if self._process is not None:
                self._process.terminate()

    def join(self) -> None:
        """Wait for the end, and make it so."""
        self._thread.join(END_S)
        if self._process is not None and self._process.poll() is None:
            _logger.warning("%s does not end and is killed", self._view.name)
            self._process.kill()
            self._thread.join()

    def _work(self) -> None:
        wait_s = FIRST_WAIT_S
        while (process := self._start()) is not None:
            began_s = time.monotonic()
            code = self._end_of(process)
            if process.stdin is not None:
                process.stdin.close()
            if self._stop.is_set():
                return
            if code == _USAGE:
                _logger.error("%s: see its message; it is not started again", self._view.name)
                return
            if time.monotonic() - began_s > CALM_S:
                wait_s = FIRST_WAIT_S
            _logger.warning("%s ended with code %d; started again in %g s", self._view.name, code, wait_s)
            if self._stop.wait(wait_s):
                return
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _end_of(self, process: subprocess.Popen[bytes]) -> int:
        """Its exit code, once it has ended, or was killed because it hangs."""
        beats, poll = self._beats, select.poll()
        poll.register(beats, select.POLLIN)
        try:
            while poll.poll(HUNG_S * 1e3):
                if not os.read(beats, 4096):
                    return process.wait()  # the other end is closed: it has ended
            _logger.warning("%s hangs: no sign of life for %g s; it is killed", self._view.name, HUNG_S)
            process.kill()
            return process.wait()
        finally:
            os.close(beats)

    def _start(self) -> subprocess.Popen[bytes] | None:
        with self._lock:
            if self._stop.is_set():
                return None
            words = [sys.executable, "-m", "gateway.views.child", self._view.name, *self._view.arguments]
            self._beats, theirs = os.pipe()
            environment = os.environ | {BEAT_VARIABLE: str(theirs)}
            try:
                self._process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=(theirs,), env=environment)
            finally:
                os.close(theirs)
            return self._process
