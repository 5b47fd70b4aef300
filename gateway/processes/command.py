"""Starts `board51` commands as processes, waits for them, and ends them reliably.

Rule: each has a process session of its own (Windows: a process group).  So Ctrl-C reaches only their parent, which then
      stops them in order: the campaign parks the ball while gateway and board still run.  They end with it, also after
      kill -9.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from gateway.processes.child import SAME_PRIORITY
from protocol.errors import ServiceError

START_LIMIT_S = 90.0  # includes the first compilation of the kernels on a slow machine
STOP_LIMIT_S = 15.0
Process = subprocess.Popen[Any]  # of bytes or of text


def start(*command: str, nicer: bool = True, **options: Any) -> Process:
    """Start `board51 COMMAND`, which ends with this process, also after kill -9 (child.py).

    It is a session of its own: Ctrl-C reaches this process alone, which ends its children in the right order.  With
    `nicer` it has a lower priority than this process.  The options are those of `subprocess.Popen`.
    """
    return subprocess.Popen(child_words(*command, nicer=nicer), stdin=subprocess.PIPE, **_group(nicer=nicer), **options)


def _group(*, nicer: bool) -> dict[str, Any]:
    if sys.platform != "win32":
        return {"start_new_session": True}
    priority = subprocess.BELOW_NORMAL_PRIORITY_CLASS if nicer else 0
    return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | priority}


def child_words(*command: str, nicer: bool = True) -> list[str]:
    """Return the command line of `board51 COMMAND` as a child, which ends when its standard input closes."""
    return [sys.executable, "-m", "gateway.processes.child", *(() if nicer else (SAME_PRIORITY,)), *command]


def order(process: Process, with_signal: signal.Signals) -> None:
    """Send a signal; Windows has only Ctrl-Break for another process, which acts as Ctrl-C (board51.py)."""
    if sys.platform != "win32":
        process.send_signal(with_signal)
        return
    try:
        process.send_signal(signal.CTRL_BREAK_EVENT)
    except OSError:  # a service has no console; the child takes the end of its input for a SIGTERM
        if process.stdin is not None:
            process.stdin.close()


def end(processes: Sequence[Process], with_signal: signal.Signals, limit_s: float) -> list[Process]:
    """Signal all processes and wait; kill and return those that still run after `limit_s`."""
    running = [process for process in processes if process.poll() is None]
    for process in running:
        order(process, with_signal)
    unfinished: list[Process] = []
    end_s = time.monotonic() + limit_s
    try:
        for process in running:
            try:
                process.wait(max(0.0, end_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                unfinished.append(process)
                process.kill()
                process.wait()
    except BaseException:  # a second Ctrl-C must leave no process behind
        for process in running:
            process.kill()
        raise
    finally:
        for process in processes:
            if process.stdin is not None:
                process.stdin.close()
    return unfinished


@contextlib.contextmanager
def running(out: Path, name: str, *words: str) -> Iterator[Process]:
    """Run a command in the background with output to OUT/NAME.log; a context manager.

    At the end of the block the process is stopped, and killed after STOP_LIMIT_S.
    """
    with (out / f"{name}.log").open("wb") as log:
        process = start(name, *words, nicer=False, stdout=log, stderr=log)
    try:
        yield process
    finally:
        end([process], signal.SIGTERM, STOP_LIMIT_S)


def call(
    out: Path,
    name: str,
    *words: str,
    good: tuple[int, ...] = (0,),
    on_line: Callable[[str], None] = lambda _: None,
    log: str = "",
) -> tuple[int, list[str]]:
    """Run a command to its end, with `log` (by default its name) in `out`; return exit code and lines of output.

    Raises:
        ServiceError: the exit code is not in `good`; the message has the last line.
    """
    process = start(name, *words, nicer=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    lines: list[str] = []
    path = out / f"{log or name}.log"
    assert process.stdout is not None
    with process.stdout, path.open("w", encoding="utf-8") as file:
        try:
            for raw in process.stdout:
                file.write(raw)
                lines.append(line := raw.rstrip())
                on_line(line)
            code = process.wait()
        finally:
            end([process], signal.SIGINT, STOP_LIMIT_S)  # as Ctrl-C: a campaign parks the ball and prints its summary
            file.write(process.stdout.read())
    _check(code, good, name, lines, path)
    return code, lines


def finish(process: Process, out: Path, name: str, *, good: tuple[int, ...], limit_s: float) -> int:
    """Wait for a process of `running`; returns its exit code.

    Raises:
        ServiceError: it takes longer than `limit_s`, or its exit code is not in `good`.
    """
    path = out / f"{name}.log"
    try:
        code = process.wait(timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise ServiceError(
            f"board51 {name} has not ended after {limit_s:.0f} s more",
            remedy=f"Its output so far is in {path}; run it alone on the same campaign",
        ) from None
    _check(code, good, name, path.read_text(encoding="utf-8", errors="replace").splitlines(), path)
    return code


def _check(code: int, good: tuple[int, ...], name: str, lines: list[str], path: Path) -> None:
    if code not in good:
        raise ServiceError(
            f"board51 {name} ended with exit code {code}: {lines[-1] if lines else 'it said nothing'}".rstrip("."),
            remedy=f"Its output is in {path}",
        )


def wait(ready: Callable[[], bool], process: Process, what: str) -> None:
    """Wait until `ready()` is true.  Raises ServiceError if the process ends before or START_LIMIT_S is over."""
    end_s = time.monotonic() + START_LIMIT_S
    while not ready():
        if process.poll() is not None or time.monotonic() > end_s:
            code = process.returncode
            problem = f"did not appear within {START_LIMIT_S:.0f} s" if code is None else f"ended with exit code {code}"
            raise ServiceError(f"{what} {problem}", remedy="Its messages are in the .log files of --out")
        time.sleep(0.05)


class EmulatedLine(NamedTuple):
    """The line between an emulated board and a gateway."""

    url: str  # for the gateway
    options: tuple[str, ...]  # for `emulate`
    served: Callable[[], bool]


# An FTDI chip's latency timer as it is by default.  The emulator needs less than half of the processor time with it.
ADAPTER = ("--latency-timer", "16")


def emulated_line(folder: Path) -> EmulatedLine:
    """Return a new line: a pty behind a link in `folder`, or TCP where the system has no ptys."""
    if os.name == "posix":
        # A link without a folder around it: the emulated board removes it, also when its parent is killed.
        link = folder / f"board51-{uuid.uuid4().hex}"
        return EmulatedLine(str(link), ("--pty", str(link), *ADAPTER), link.exists)
    port = free_port()
    return EmulatedLine(f"socket://127.0.0.1:{port}", ("--tcp", f"127.0.0.1:{port}", *ADAPTER), partial(listens, port))


def free_port() -> int:
    """A free TCP port on loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listens(port: int) -> bool:
    """Return whether a server listens on this port of loopback."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
