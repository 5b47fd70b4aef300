"""A program run twice: with compiled kernels, and with kernels as plain Python."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any


def compiled_and_plain(program: str) -> list[Any]:
    """Return what the program prints as JSON, compiled first."""
    return [
        json.loads(
            subprocess.run(
                [sys.executable, "-c", program],
                env={**os.environ, "NUMBA_DISABLE_JIT": off},
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
        for off in ("0", "1")
    ]
