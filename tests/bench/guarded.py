"""The cost of guarding the bus: TLS, passwords and access control against plain TCP, in the same run."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from gateway.access.folder import SecurityFolder
from tests.bench.gateway import WINDOW_S, measure


def run() -> list[dict[str, Any]]:
    """Rows for `board51 bench`."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="board51-bench-") as name:
        keys = SecurityFolder(Path(name) / "keys")
        keys.init(site="bench")
        for boards in (1, 8):
            guarded, plain = measure(boards, bare=False, keys=keys.path), measure(boards, bare=False)
            for what, unit in (("median_ms", "ms"), ("p99_ms", "ms"), ("cores", "cores")):
                value, baseline = getattr(guarded, what), getattr(plain, what)
                rows.append(
                    {"name": f"guarded, {boards} boards: {what}", "value": value, "unit": unit, "baseline": baseline,
                     "ratio": value / baseline if baseline else None, "note": "baseline: the bus not guarded"}
                )  # fmt: skip
            lost = {"name": f"guarded, {boards} boards: lost of {guarded.sent}", "value": guarded.lost}
            rows.append({**lost, "unit": "samples", "baseline": plain.lost, "ratio": None, "note": f"{WINDOW_S:.0f} s"})
    return rows
