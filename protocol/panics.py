"""Detection of a panic in zenoh's library, by the line that Rust writes to stderr.  Pure.

After a panic in one of its threads the library keeps running without that thread.  For example, it may no longer
receive from one peer, or may hold a lock for ever.  No call or event of its API reports this (upstream issue 2624 is
one case, with sessions that open and close).  The parent process therefore reads stderr (`board51.py`), ends a process
after a panic, and starts it again.
"""

from __future__ import annotations

import re

_PANIC = re.compile(rb"thread '[^']*'( \(\d+\))? panicked at")
_PANICKED = re.compile(rb" panicked at")


def is_panic(line: bytes) -> bool:
    """Return whether a line of stderr reports a panic."""
    return _PANIC.search(line) is not None


def reword(line: bytes) -> bytes:
    """Return the line reworded, so that a parent that reads this process's stderr does not take it for a new panic."""
    return _PANICKED.sub(b" panicked, and its process ends, at", line)
