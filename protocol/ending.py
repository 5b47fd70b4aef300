"""The order to end, which SIGTERM and SIGINT give to a service.

This module handles both signals; other modules ask it whether the end is ordered.

zenoh may panic while its session closes: a transport that closes at the same moment finds its tables empty.  This
happened in 12 of 160 ends of a router with three clients (zenoh 1.10).  By then nothing can be lost any more.
`board51.py` therefore asks `end_is_ordered` before it makes a failure of a panic.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_state = {"ordered": False}


def on_end_signal(end: Callable[[], object]) -> None:
    """Call `end` at SIGTERM and at SIGINT; only the main thread may ask for this."""

    def handle(_number: int, _frame: object) -> None:
        note_end()
        end()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handle)


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
