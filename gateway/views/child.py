"""Runs one `board51` command as a child of the gateway: `python -m gateway.views.child opcua --listen ...`.

It ends when its standard input does: with the gateway, however that ended.  It gives way to the gateway on a busy
machine (NICER, and never in real time, as a gateway may run), and starts without what the gateway's process has grown:
no fork of a process full of threads.
"""

from __future__ import annotations

import os
import signal
import sys
import threading

NICER = 5


def _end_with_parent() -> None:
    while os.read(sys.stdin.fileno(), 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> int:
    """Exit code of the command."""
    import board51

    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICER)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    return board51.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
