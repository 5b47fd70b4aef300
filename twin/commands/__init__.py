"""The sub-commands of `board51` of the twin; each has `configure` and `run`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable


def progress_printer(*, quiet: bool) -> Callable[[str], None]:
    """Return what prints lines of progress to stderr, each with the time since this call; nothing if `quiet`."""
    began = time.monotonic()

    def progress(line: str) -> None:
        if not quiet:
            print(f"[{time.monotonic() - began:5.1f} s] {line}", file=sys.stderr, flush=True)

    return progress
