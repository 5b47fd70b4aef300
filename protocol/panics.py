"""How a panic of zenoh's shows: the one line that Rust writes to stderr.  Pure.

zenoh's library goes on after a panic in one of its threads: what that thread did (receiving from one peer, say) is
done no more, and perhaps a lock stays taken.  No call and no event tells it; upstream issue 2624 is one, under sessions
that come and go.  So whoever runs such a process reads its stderr (`board51.py`) and ends it, to be started again.
"""

from __future__ import annotations

import re

_PANIC = re.compile(rb"thread '[^']*'( \(\d+\))? panicked at")
_TOLD = re.compile(rb" panicked at")


def is_panic(line: bytes) -> bool:
    """Whether a line of stderr is one."""
    return _PANIC.search(line) is not None


def told(line: bytes) -> bytes:
    """The same for who reads this process's stderr, and is not to take it for a panic of its own."""
    return _TOLD.sub(b" panicked, and its process ends, at", line)
