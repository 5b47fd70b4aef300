"""Processes of a benchmark: started in this checkout, awaited, their CPU time read from /proc."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

SCRIPTS = Path(__file__).parent
ROOT = Path(__file__).parents[3]
LISTENS_S = 60.0
END_S = 60.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def start(*words: object, first: bool = False, **variables: str) -> subprocess.Popen[str]:
    """`python WORDS` with these environment variables besides this process's; `first`: before ordinary processes."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}

    def go_first() -> None:
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))

    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # a line per board and change of link
        text=True,
        env=environment,
        cwd=ROOT,
        preexec_fn=go_first if first else None,
    )


def ready(process: subprocess.Popen[str]) -> None:
    """Wait for its line `ready`.

    Raises:
        RuntimeError: it ended or said something else.
    """
    assert process.stdout is not None
    line = process.stdout.readline()
    if line.strip() != "ready":
        raise RuntimeError(f"{process.args!r} did not start: {line!r}")


def goes_first(process: subprocess.Popen[str]) -> bool:
    """Return whether the process was allowed to run before ordinary processes."""
    return os.sched_getscheduler(process.pid) == os.SCHED_RR


def listening(endpoint: str) -> None:
    """Wait until somebody takes connections at `tcp/HOST:PORT`.

    Raises:
        RuntimeError: nobody does within LISTENS_S.
    """
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    end_s = time.monotonic() + LISTENS_S
    while time.monotonic() < end_s:
        with suppress(OSError), socket.create_connection((host, int(port)), timeout=1.0):
            return
        time.sleep(0.05)
    raise RuntimeError(f"nothing listens on {endpoint}")


def end(processes: list[subprocess.Popen[str]]) -> None:
    """SIGTERM to the youngest first, so that nobody loses what is under way; who does not end is killed."""
    for process in reversed(processes):
        process.terminate()
        try:
            process.wait(timeout=END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def cpu_s(pid: int) -> float:
    """CPU time of one process so far, user and system."""
    return _stat(pid)[1]


def tree_cpu_s(pid: int) -> float:
    """CPU time of a process and all that it started and that still run."""
    parents, times = dict[int, int](), dict[int, float]()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):  # it has just ended
                parents[int(entry.name)], times[int(entry.name)] = _stat(int(entry.name))
    total_s, waiting = 0.0, [pid]
    while waiting:
        this = waiting.pop()
        total_s += times.get(this, 0.0)
        waiting += [child for child, parent in parents.items() if parent == this]
    return total_s


def machine_cpu_s() -> float:
    """CPU time of everything on this machine so far, all cores, without idling."""
    user, nice, system, _, _, irq, softirq, *_ = map(int, Path("/proc/stat").read_text(encoding="ascii").split()[1:9])
    return (user + nice + system + irq + softirq) / _TICKS_PER_S


def child(parent: int, word: str) -> int:
    """The pid of the child of `parent` that has `word` among its arguments.

    Raises:
        RuntimeError: there is none.
    """
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                words = (entry / "cmdline").read_bytes().split(b"\0")
                if _stat(int(entry.name))[0] == parent and word.encode() in words:
                    return int(entry.name)
    raise RuntimeError(f"process {parent} has no child {word}")


def _stat(pid: int) -> tuple[int, float]:
    """(parent, CPU time in s)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return int(fields[1]), (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
