"""Work that goes on beside a block of a test."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def repeated(work: Callable[[], object], period_s: float) -> Iterator[None]:
    """Call `work` over and over in a thread until the block ends."""
    stop = threading.Event()

    def repeat() -> None:
        while not stop.wait(period_s):
            work()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
