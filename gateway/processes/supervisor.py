"""Supervises child processes: restarts them after a failure, and ends them with this process.

Rule 1: a failure of a child is logged and does not affect anything else.
Rule 2: a failed child is restarted after 1 s, 2 s, ... at most 30 s; after a minute without failure, after 1 s again.
Rule 3: exit code 2 means a wrong option or file, which a restart cannot correct: the child is not restarted.
Rule 4: a hanging child is killed and restarted: each child sends beats (child.py), and HUNG_S without one is a hang.
        On Windows there are no beats, and a hang is not noticed.
Rule 5: no child outlives this process, not even after kill -9 (see child.py).
"""

from __future__ import annotations

import logging
import os
import select
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.processes.child import BEAT_VARIABLE, HAS_BEATS
from gateway.processes.command import Process, end, start

FIRST_WAIT_S = 1.0
LONGEST_WAIT_S = 30.0
CALM_S = 60.0
END_S = 20.0  # time to end before the child is killed; a page gives its campaign 15 s to park the ball
HUNG_S = 20.0  # much longer than any delay on a busy machine
_USAGE = 2
_logger = logging.getLogger("gateway.views")


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """A `board51` command to keep running."""

    name: str
    arguments: tuple[str, ...]
    output: Path | None = None  # receives its output; None: as this process


@contextmanager
def running(services: Sequence[Service], *, end_s: float = END_S) -> Iterator[None]:
    """Context manager: keep the services running within the block; then kill what has not ended within `end_s`.

    That must be more than the time of their own children.
    """
    keepers = [_Keeper(service) for service in services]
    try:
        yield
    finally:
        last = {process: keeper for keeper in keepers if (process := keeper.stop()) is not None}
        for process in end(list(last), signal.SIGTERM, end_s):
            _logger.warning("%s does not end and is killed", last[process].name)
        for keeper in keepers:
            keeper.join()


class _Keeper:
    """Keeps one service running, in a thread of its own."""

    def __init__(self, service: Service) -> None:
        self.name = service.name
        self._command = (service.name, *service.arguments)
        self._output = service.output
        self._where = f" (its output is in {service.output})" if service.output else ""
        self._stop = threading.Event()
        self._lock = threading.Lock()  # a stop must not slip between a look at it and a start
        self._process: Process | None = None
        self._beats = -1  # read end of its pipe
        self._thread = threading.Thread(target=self._work, name=f"view-{service.name}", daemon=True)
        self._thread.start()

    def stop(self) -> Process | None:
        """Prevent further starts, and return the process to end."""
        with self._lock:
            self._stop.set()
            return self._process

    def join(self) -> None:
        """Wait for the thread; its process has ended."""
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
                _logger.error("%s: see its message; it is not started again%s", self.name, self._where)
                return
            if time.monotonic() - began_s > CALM_S:
                wait_s = FIRST_WAIT_S
            _logger.warning("%s ended with code %d; started again in %g s%s", self.name, code, wait_s, self._where)
            if self._stop.wait(wait_s):
                return
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _end_of(self, process: Process) -> int:
        """Wait for the process, or kill it if it hangs; return its exit code."""
        if not HAS_BEATS:
            return process.wait()
        beats, poll = self._beats, select.poll()
        poll.register(beats, select.POLLIN)
        try:
            while poll.poll(HUNG_S * 1e3):
                if not os.read(beats, 4096):
                    return process.wait()  # the other end is closed: it has ended
            _logger.warning("%s hangs: no sign of life for %g s; it is killed", self.name, HUNG_S)
            process.kill()
            return process.wait()
        finally:
            os.close(beats)

    def _start(self) -> Process | None:
        with self._lock:
            if self._stop.is_set():
                return None
            with ExitStack() as last:
                output = self._output and last.enter_context(self._output.open("ab"))
                options: dict[str, Any] = {"stdout": output, "stderr": output}
                if HAS_BEATS:
                    self._beats, theirs = os.pipe()
                    last.callback(os.close, theirs)
                    options |= {"pass_fds": (theirs,), "env": os.environ | {BEAT_VARIABLE: str(theirs)}}
                self._process = start(*self._command, **options)
            return self._process
