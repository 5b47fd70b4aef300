"""Starts `board51` commands as processes, and ends them reliably."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

Process = subprocess.Popen[Any]  # of bytes or of text


def words_of(*command: str, child: bool = False) -> list[str]:
    """Return the command line of `board51 COMMAND`; with `child`, the process ends with this one (child.py)."""
    return [sys.executable, "-m", "gateway.processes.child" if child else "board51", *command]


def end(processes: Sequence[Process], with_signal: signal.Signals, limit_s: float) -> list[Process]:
    """Signal all processes and wait; kill and return those that still run after `limit_s`."""
    running = [process for process in processes if process.poll() is None]
    for process in running:
        process.send_signal(with_signal)
    late: list[Process] = []
    end_s = time.monotonic() + limit_s
    try:
        for process in running:
            try:
                process.wait(max(0.0, end_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                late.append(process)
                process.kill()
                process.wait()
    except BaseException:  # a second Ctrl-C must leave no process behind
        for process in running:
            process.kill()
        raise
    return late
