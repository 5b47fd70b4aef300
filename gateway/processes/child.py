"""Runs one `board51` command as a child of another: `python -m gateway.processes.child opcua --listen ...`.

It ends when its standard input closes, which happens when its parent ends for any reason.  What the parent writes
there reaches the command's own standard input (`replay --control`).  It runs at a lower priority than its parent,
unless the first word is SAME_PRIORITY, and never in real time, as a gateway may.  NICER is the difference; where
other programs fill the machine, a job would starve, and NICE_VARIABLE sets a smaller one, from 0 to MAX_NICE.  It is a
new interpreter and not a fork of a multi-threaded parent.

Its main thread writes a byte every BEAT_S to the descriptor in the environment (BEAT_VARIABLE).  It does so
in a signal handler, which Python runs there and nowhere else.  A process that is stopped, or whose main thread hangs
in a call, falls silent.  Windows has no timer that gives signals (`HAS_BEATS`): there nobody notices a hang.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType

from protocol.ending import order_end

NICER = 5
MAX_NICE = 19
NICE_VARIABLE = "BOARD51_CHILD_NICE"
SAME_PRIORITY = "--same-priority"
BEAT_S = 1.0
BEAT_VARIABLE = "BOARD51_BEAT_FD"
HAS_BEATS = hasattr(signal, "setitimer")


def _end_with_parent(source: int, sink: int) -> None:
    while data := os.read(source, 1024):
        os.write(sink, data)  # a command that does not read has room for 64 kB, and no parent writes to one
    order_end()


def _hand_on_input() -> None:
    """Put a pipe in the place of standard input, so that its end is seen whatever the command reads."""
    number = sys.stdin.fileno()
    source, (read, write) = os.dup(number), os.pipe()
    os.dup2(read, number)
    os.close(read)
    threading.Thread(target=_end_with_parent, args=(source, write), daemon=True).start()


def _nicer() -> int:
    """Return by how much this process gives way.  A wrong value must not take the web page and its STOP away."""
    stated = os.environ.get(NICE_VARIABLE, "").strip()
    if stated.isdecimal() and int(stated) <= MAX_NICE:
        return int(stated)
    if stated:
        text = f"{NICE_VARIABLE}: {stated!r} is not a whole number from 0 to {MAX_NICE}; {NICER} is used"
        print(text, file=sys.stderr, flush=True)  # noqa: T201  # the command is not known yet
    return NICER


def _beat() -> None:
    descriptor = int(os.environ.pop(BEAT_VARIABLE, "-1"))
    if descriptor < 0:
        return
    os.set_inheritable(descriptor, False)
    os.set_blocking(descriptor, False)

    def beat(_number: int, _frame: FrameType | None) -> None:
        with suppress(OSError):  # the gateway has ended, and this process is about to end
            os.write(descriptor, b".")

    signal.signal(signal.SIGALRM, beat)
    signal.setitimer(signal.ITIMER_REAL, BEAT_S, BEAT_S)


def main() -> int:
    """Run the command and return its exit code."""
    import board51

    words = sys.argv[1:]
    if words[:1] == [SAME_PRIORITY]:
        words = words[1:]
    else:
        if hasattr(os, "sched_setscheduler"):  # Linux
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        if hasattr(os, "nice"):  # not on Windows, where `command.start` gives the priority
            os.nice(_nicer())
    _hand_on_input()
    _beat()
    try:
        return board51.main(words)
    finally:
        # Python takes its signal handlers away at its end: a beat after that would kill it, and hide its exit code.
        if HAS_BEATS:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


if __name__ == "__main__":
    sys.exit(main())
