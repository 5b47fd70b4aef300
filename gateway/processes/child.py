"""Runs one `board51` command as a child of the gateway: `python -m gateway.processes.child opcua --listen ...`.

It ends when its standard input does: with the gateway, however that ended.  It gives way to the gateway on a busy
machine (NICER, and never in real time, as a gateway may run), and starts without what the gateway's process has grown:
no fork of a process full of threads.

Its main thread writes a byte every BEAT_S to the descriptor in the environment (BEAT_VARIABLE): from a signal
handler, which Python runs there and nowhere else.  A process that is stopped, or whose main thread hangs in a call,
falls silent.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType

NICER = 5
BEAT_S = 1.0
BEAT_VARIABLE = "BOARD51_BEAT_FD"


def _end_with_parent() -> None:
    while os.read(sys.stdin.fileno(), 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _beat() -> None:
    descriptor = int(os.environ.pop(BEAT_VARIABLE, "-1"))
    if descriptor < 0:
        return
    os.set_inheritable(descriptor, False)
    os.set_blocking(descriptor, False)

    def beat(_number: int, _frame: FrameType | None) -> None:
        with suppress(OSError):  # nobody reads it any more: the gateway is gone, and so is this process in a moment
            os.write(descriptor, b".")

    signal.signal(signal.SIGALRM, beat)
    signal.setitimer(signal.ITIMER_REAL, BEAT_S, BEAT_S)


def main() -> int:
    """Exit code of the command."""
    import board51

    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICER)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _beat()
    return board51.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
