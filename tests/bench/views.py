"""The cost of the control room: 8 boards at 500 Hz with OPC UA, web page and their clients, against the gateway alone.

As in gateway.py: the load, the gateway as a user starts it (log on), a zenoh subscriber that notes each arrival.  Then
the same with `--opcua --hmi`, four OPC UA clients (20 variables each, 50 Hz) and four headless Chromiums.  All of it
shares this machine's cores; in a plant browsers and SCADA are other machines, so their processes run at nice
CLIENTS_NICE here: BOARD51_BENCH_NICE=0 lets them compete with the gateway on equal terms.  The gateway runs in real
time in both, where this user may, as its service unit has it; BOARD51_BENCH_PLAIN=1: as any process.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from tests.bench.gateway import TAIL_S, WINDOW_S, Result, result
from tests.bench.line import processes as line
from tests.harness.gateway.chromium import ABSENT, CHROMIUM
from tests.harness.ports import free_port

BOARDS = 8
CLIENTS = 4  # of either kind
CLIENTS_NICE = os.environ.get("BOARD51_BENCH_NICE", "10")
PLAIN = os.environ.get("BOARD51_BENCH_PLAIN") == "1"
WARM_S = 15.0  # four browsers that have just started take both cores for some seconds
START_UP_S = 400.0  # until all views and clients are up, on a busy machine
Row = dict[str, Any]
Counts = list[dict[str, float]]
Begin = Callable[..., subprocess.Popen[str]]  # title, words, environment


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """The measurements of one run within the window."""

    line: Result
    not_logged: int  # samples that were sent and are not in the log
    first: bool  # the gateway before ordinary processes
    gateway_p99_ms: float  # read to handed to zenoh, as the gateway says itself; median of its seconds
    cores: dict[str, float]  # CPU seconds per second, by process
    values: Counts  # by OPC UA client
    frames: Counts  # by browser


def run() -> list[Row]:
    """Rows for `board51 bench`."""
    quiet, loaded = measure(clients=False), measure(clients=True)
    busy = f"baseline: no views, no clients; {WINDOW_S:.0f} s, gateway {'SCHED_RR' if loaded.first else 'SCHED_OTHER'}"
    rows: list[Row] = []
    for name, unit in (("p99_ms", "ms"), ("median_ms", "ms")):
        rows.append(
            _row(f"gateway with clients: {name}", getattr(loaded.line, name), unit, busy, getattr(quiet.line, name))
        )
    rows.append(_row("read to zenoh, the gateway's own p99", loaded.gateway_p99_ms, "ms", busy, quiet.gateway_p99_ms))
    rows.append(
        _row(f"lost for the subscriber, of {loaded.line.sent}", loaded.line.lost, "samples", busy, quiet.line.lost)
    )
    rows.append(_row(f"lost in the log, of {loaded.line.sent}", loaded.not_logged, "samples", busy, quiet.not_logged))
    for n, counts in enumerate(loaded.values):
        longest = f"longest interval {counts['longest_ms']:.0f} ms"
        rows.append(_row(f"OPC UA client {n + 1}: each variable", counts["per_s"], "values/s", longest))
    for n, counts in enumerate(loaded.frames):
        longest = f"longest interval {counts['longest_ms']:.0f} ms; number changes {counts['values_per_s']:.0f}/s"
        rows.append(_row(f"browser {n + 1}", counts["per_s"], "frames/s", longest))
    if not loaded.frames:
        rows.append({"name": "browsers", "value": None, "unit": "", "note": f"NOT MEASURED: {ABSENT}"})
    for name, cores in loaded.cores.items():
        rows.append(_row(f"CPU: {name}", cores, "cores", "", quiet.cores.get(name)))
    return rows


def measure(*, clients: bool) -> Measurement:
    """Measure one run, with views and clients or without."""
    with tempfile.TemporaryDirectory(prefix="board51-bench-") as name:
        folder = Path(name)
        endpoint, opcua, hmi = f"tcp/127.0.0.1:{free_port()}", free_port(), free_port()
        running: list[subprocess.Popen[str]] = []
        counting: list[subprocess.Popen[str]] = []
        clocks: dict[str, Callable[[], float]] = {}

        def begin(title: str, *words: object, first: bool = False, **variables: str) -> subprocess.Popen[str]:
            running.append(line.start(*words, first=first, **variables))
            pid = running[-1].pid
            clocks[title] = lambda: line.tree_cpu_s(pid)
            return running[-1]

        try:
            seconds = START_UP_S + WARM_S + WINDOW_S + TAIL_S
            line.ready(begin("emulated boards", line.SCRIPTS / "load.py", folder, BOARDS, seconds))
            boards = [word for n in range(BOARDS) for word in ("--board", f"b{n}={folder}/tty{n}")]
            views = (
                ["--opcua", f"127.0.0.1:{opcua}", "--opcua-rate", "50", "--hmi", f"127.0.0.1:{hmi}"] if clients else []
            )
            middle = begin("gateway", "-m", "board51", "gateway", "--site", "bench", *boards, "--listen", endpoint,
                           "--log-dir", folder / "logs", *views, first=not PLAIN)  # fmt: skip
            clocks["gateway"] = lambda: line.cpu_s(middle.pid)  # its views apart
            line.listening(endpoint)
            first = line.goes_first(middle)
            line.ready(begin("zenoh subscriber", line.SCRIPTS / "subscriber.py", folder, endpoint))
            if clients:
                counting = _begin_clients(begin, folder, opcua, hmi)
                for view in ("opcua", "hmi"):
                    pid = line.child(middle.pid, view)
                    clocks[f"{view} server"] = lambda pid=pid: line.cpu_s(pid)  # type: ignore[misc]  # mypy infers no lambda with a default
            time.sleep(WARM_S)
            for process in counting:
                process.send_signal(signal.SIGUSR1)
            since_ns, before = time.monotonic_ns(), _read(clocks)
            time.sleep(WINDOW_S)
            until_ns, after = time.monotonic_ns(), _read(clocks)
            time.sleep(TAIL_S)  # what was written at the end of the window may arrive
        finally:
            line.end(running)
        cores = {title: (after[title] - before[title]) / WINDOW_S for title in after}
        cores["everything else on this machine"] = cores.pop("machine") - sum(cores.values())
        outcome = result(folder, since_ns, until_ns, cores["gateway"] * WINDOW_S)
        not_logged, gateway_p99_ms = _of_log(folder, since_ns, until_ns)
        return Measurement(line=outcome, first=first, not_logged=not_logged, gateway_p99_ms=gateway_p99_ms, cores=cores,
                     values=_counts(folder / "counts.json"), frames=_counts(folder / "frames.json"))  # fmt: skip


def _begin_clients(begin: Begin, folder: Path, opcua: int, hmi: int) -> list[subprocess.Popen[str]]:
    nice = {"BOARD51_BENCH_NICE": CLIENTS_NICE}
    line.listening(f"tcp/127.0.0.1:{opcua}")
    clients = [begin("OPC UA clients", line.SCRIPTS / "opcua_clients.py", folder, opcua, CLIENTS, BOARDS, **nice)]
    line.ready(clients[0])
    if CHROMIUM is not None:
        line.listening(f"tcp/127.0.0.1:{hmi}")
        clients.append(begin("browsers", line.SCRIPTS / "browsers.py", folder, hmi, CLIENTS, BOARDS, **nice))
        line.ready(clients[1])
    return clients


def _read(clocks: dict[str, Callable[[], float]]) -> dict[str, float]:
    return {"machine": line.machine_cpu_s(), **{title: clock() for title, clock in clocks.items()}}


def _of_log(folder: Path, since_ns: int, until_ns: int) -> tuple[int, float]:
    """(samples of the window that the log lacks, median of the gateway's own p99 in ms)."""
    written = np.load(folder / "written.npy")
    logged = np.zeros(written.shape, bool)
    latencies_ms = []
    offset_ns = time.time_ns() - time.monotonic_ns()  # of Unix time
    for record in read(sorted((folder / "logs").glob("*.mcap")), topics=("state", "status")):
        if isinstance(record.message, pb.State):
            logged[int(record.board[1:]), record.message.tick % written.shape[1]] = True
        elif isinstance(record.message, pb.Status) and since_ns < record.time_ns - offset_ns < until_ns:
            latencies_ms.append(record.message.latency_p99_ms)
    in_window = (written >= since_ns) & (written < until_ns)
    return int((in_window & ~logged).sum()), float(np.median(latencies_ms)) if latencies_ms else float("nan")


def _counts(path: Path) -> Counts:
    counts: Counts = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    return counts


def _row(name: str, value: float, unit: str, note: str, baseline: float | None = None) -> Row:
    ratio = value / baseline if baseline else None
    return {"name": name, "value": value, "unit": unit, "baseline": baseline, "ratio": ratio, "note": note}


if __name__ == "__main__":
    for row in run():
        print(row)
