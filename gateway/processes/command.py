"""Starts `board51` commands as processes, and ends them reliably."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

from gateway.processes.child import SAME_PRIORITY

Process = subprocess.Popen[Any]  # of bytes or of text


def start(*command: str, nicer: bool = True, **options: Any) -> Process:
    """Start `board51 COMMAND`, which ends with this process, also after kill -9 (child.py).

    It is a session of its own: Ctrl-C reaches this process alone, which ends its children in the right order.

    Args:
        command: the words after `board51`.
        nicer: run at a lower priority than this process.
        options: of `subprocess.Popen`.
    """
    return subprocess.Popen(
        child_words(*command, nicer=nicer), stdin=subprocess.PIPE, start_new_session=True, **options
    )


def child_words(*command: str, nicer: bool = True) -> list[str]:
    """Return the command line of `board51 COMMAND` as a child, which ends when its standard input closes."""
    return [sys.executable, "-m", "gateway.processes.child", *(() if nicer else (SAME_PRIORITY,)), *command]


def end(processes: Sequence[Process], with_signal: signal.Signals, limit_s: float) -> list[Process]:
    """Signal all processes and wait; kill and return those that still run after `limit_s`."""
    running = [process for process in processes if process.poll() is None]
    for process in running:
        process.send_signal(with_signal)
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
