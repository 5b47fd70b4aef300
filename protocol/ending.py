"""The order to end, which SIGTERM and SIGINT give to a service; and the end by a panic in zenoh's library.

This module handles both signals; other modules ask it whether the end is ordered.  On Windows the order from outside
is Ctrl-C or Ctrl-Break (SIGBREAK), which `board51.py` makes the same; a SIGTERM comes from the process itself.

A panic is detected by the line that Rust writes to stderr.  After a panic in one of its threads the library keeps
running without that thread.  For example, it may no longer receive from one peer, or may hold a lock for ever.  No call
or event of its API reports this (upstream issue 2624 is one case, with sessions that open and close).  The parent
process therefore reads stderr (`board51.py`), ends a process after a panic, and starts it again.

zenoh may panic while its session closes: a transport that closes at the same moment finds its tables empty.  This
happened in 12 of 160 ends of a router with three clients (zenoh 1.10).  By then nothing can be lost any more.
`board51.py` therefore asks `end_is_ordered` before it makes a failure of a panic.
"""

from __future__ import annotations

import _thread
import math
import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_PANIC = re.compile(rb"thread '[^']*'( \(\d+\))? panicked at")
_state = {"ordered": False}


def on_end_signal(end: Callable[[], object]) -> None:
    """Call `end` at SIGTERM and at SIGINT; only the main thread may ask for this."""
    act = in_thread(end)

    def handle(_number: int, _frame: object) -> None:
        note_end()
        act()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handle)


def in_thread(act: Callable[[], object]) -> Callable[[], None]:
    """Return a function that calls `act` in a thread of its own, for signals.

    A signal is handled in the main thread, which may be about to wait for an event and hold its lock.  To set the event
    there would wait for that lock for ever.
    """

    def start() -> None:
        _thread.start_new_thread(act, ())  # not `threading`, which has locks of its own

    return start


def end_at_once() -> None:
    """Let SIGTERM and SIGINT end this process as the system does, until `on_end_signal`: it has begun nothing yet.

    Python's own handler would wait for what runs in C, such as a compilation, and for the threads of pools.
    """
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)


def order_end() -> None:
    """Give this process a SIGTERM, from any thread."""
    if os.name == "posix" or signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        os.kill(os.getpid(), signal.SIGTERM)
    else:  # there os.kill calls no handler
        _thread.interrupt_main(signal.SIGTERM)


def wait_for_end(wait: Callable[[float], bool], limit_s: float | None = None) -> None:
    """Wait for an event that a signal sets, with its `wait`, or for `limit_s`.

    In steps: on Windows a signal is handled between two waits and not during one.
    """
    left_s = math.inf if limit_s is None else limit_s
    while left_s > 0.0 and not wait(min(left_s, 1.0)):
        left_s -= 1.0


def note_end() -> None:
    """Note that the work is over, for a service that ends by itself, such as after --seconds."""
    _state["ordered"] = True


def end_is_ordered() -> bool:
    """Return whether the end was ordered or the work is over."""
    return _state["ordered"]


@contextmanager
def on_signals(act: Callable[[], object], *signals: signal.Signals) -> Iterator[None]:
    """Call `act` at each of these signals within the block; after it they act as before."""
    before = {number: signal.signal(number, lambda *_: act()) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def is_panic(line: bytes) -> bool:
    """Return whether a line of stderr reports a panic."""
    return _PANIC.search(line) is not None


def reword(line: bytes) -> bytes:
    """Return the line reworded, so that a parent that reads this process's stderr does not take it for a new panic."""
    return line.replace(b" panicked at", b" panicked, and its process ends, at")
