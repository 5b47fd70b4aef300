"""A `board51` command as a process of its own: how it is called, and how it ends whatever happens."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

Process = subprocess.Popen[Any]  # of bytes or of text


def words_of(*command: str, child: bool = False) -> list[str]:
    """`board51 COMMAND` of this interpreter; `child`: one that ends with this process (child.py)."""
    return [sys.executable, "-m", "gateway.processes.child" if child else "board51", *command]


def end(processes: Sequence[Process], with_signal: signal.Signals, limit_s: float) -> list[Process]:
    """Signal all of them and wait; those that are not done after `limit_s` are killed and returned."""
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
    except BaseException:  # somebody is in a hurry: a second Ctrl-C must leave none behind
        for process in running:
            process.kill()
        raise
    return late
