"""End to end: byte written by a board to sample in a subscriber of another process, 1, 8 and 32 boards at 500 Hz.

Four processes on this machine: the load (line/load.py), the gateway as a user starts it (log on), a subscriber, and
this one.  The baseline, in the same run with the same load and subscriber, is line/bare_loop.py for the gateway.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.line import steps
from tests.bench.line.processes import SCRIPTS, cpu_s, end, listening, ready, start
from tests.harness.ports import free_port

WARM_S = 4.0  # start-up, handshake, caches
WINDOW_S = float(os.environ.get("BOARD51_BENCH_SECONDS", "10"))
TAIL_S = 1.5
PERIOD_S = 2e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The measurements of one run within the window."""

    median_ms: float
    p99_ms: float
    lost: int
    sent: int
    cores: float  # CPU seconds per second of the gateway or the bare loop
    us_per_frame: float


def run(part: str = "") -> list[dict[str, Any]]:
    """Rows for `board51 bench`; `part` is `steps`, a number of boards, or "" for all of them."""
    rows = steps.run() if part in ("", "steps") else []
    for boards in (1, 8, 32) if not part else () if part == "steps" else (int(part),):
        complete, bare = measure(boards, bare=False), measure(boards, bare=True)
        for name, unit in (("median_ms", "ms"), ("p99_ms", "ms"), ("cores", "cores"), ("us_per_frame", "us")):
            value, baseline = getattr(complete, name), getattr(bare, name)
            rows.append(
                {"name": f"{boards} boards: {name}", "value": value, "unit": unit, "baseline": baseline,
                 "ratio": value / baseline if baseline else None, "note": "baseline: bare loop"}
            )  # fmt: skip
        lost = {"name": f"{boards} boards: lost of {complete.sent}", "value": complete.lost, "unit": "samples"}
        rows.append({**lost, "baseline": bare.lost, "ratio": None, "note": f"{WINDOW_S:.0f} s"})
    return rows


def measure(boards: int, *, bare: bool, keys: Path | None = None) -> Result:
    """Measure one run with the gateway, or with the bare loop.

    Args:
        boards: how many, at 500 Hz each.
        bare: the loop in place of the gateway.
        keys: folder of `board51 security init --site bench`: the gateway's bus is guarded with TLS.
    """
    with tempfile.TemporaryDirectory(prefix="board51-bench-") as name:
        folder = Path(name)
        endpoint = f"{'tls' if keys else 'tcp'}/127.0.0.1:{free_port()}"
        guard = ["--security", keys] if keys else []
        identity = {"BOARD51_IDENTITY": str(keys / "identities" / "views")} if keys else {}
        processes: list[subprocess.Popen[str]] = []
        try:
            seconds = WARM_S + WINDOW_S + TAIL_S + 30
            processes.append(start(SCRIPTS / "load.py", folder, boards, seconds))
            ready(processes[-1])
            if bare:
                middle = start(SCRIPTS / "bare_loop.py", folder, boards, endpoint)
            else:
                names = [word for n in range(boards) for word in ("--board", f"b{n}={folder}/tty{n}")]
                middle = start("-m", "board51", "gateway", "--site", "bench", *names, "--listen", endpoint,
                               "--log-dir", folder / "logs", *guard)  # fmt: skip
            processes.append(middle)
            listening(endpoint)
            processes.append(start(SCRIPTS / "subscriber.py", folder, endpoint, first=False, **identity))
            ready(processes[-1])
            time.sleep(WARM_S)
            begin, cpu = time.monotonic_ns(), cpu_s(middle.pid)
            time.sleep(WINDOW_S)
            over, cpu = time.monotonic_ns(), cpu_s(middle.pid) - cpu
            time.sleep(TAIL_S)  # what was written at the end of the window may arrive
        finally:
            end(processes)
        return result(folder, begin, over, cpu)


def result(folder: Path, begin: int, over: int, cpu: float) -> Result:
    """Return the result of one run from the records that load and subscriber wrote.

    Args:
        folder: with written.npy and arrived.npy.
        begin: of the window, CLOCK_MONOTONIC, ns.
        over: its end, likewise.
        cpu: CPU time of the gateway within the window, s.
    """
    written = np.load(folder / "written.npy")
    arrived = np.load(folder / "arrived.npy")
    at = np.zeros_like(written)
    at[arrived[:, 0], arrived[:, 1] % written.shape[1]] = arrived[:, 2]
    in_window = (written >= begin) & (written < over)
    got = in_window & (at > 0)
    latency_ms = (at[got] - written[got]) * 1e-6
    sent = int(in_window.sum())
    seconds = (over - begin) * 1e-9
    return Result(
        median_ms=float(np.median(latency_ms)) if latency_ms.size else float("nan"),
        p99_ms=float(np.percentile(latency_ms, 99)) if latency_ms.size else float("nan"),
        lost=sent - int(got.sum()),
        sent=sent,
        cores=cpu / seconds,
        us_per_frame=cpu * 1e6 / max(1, sent),
    )


if __name__ == "__main__":
    for row in run():
        print(row)
