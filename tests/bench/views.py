"""What clients cost: 8 boards at 500 Hz, with OPC UA and 4 clients (20 variables, 50 Hz), against none.

As in gateway.py: the load, the gateway as a user starts it (log on), a zenoh subscriber; then the same with
`--opcua` and a process of four OPC UA clients beside them.  All of it shares this machine's cores.
"""

from __future__ import annotations

import json
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.bench import gateway as line

BOARDS = 8
CLIENTS = 4
SERVED_S = 20.0  # until the server has the boards; eight of them have 3000 nodes


def run() -> list[dict[str, Any]]:
    """Rows for `board51 bench`."""
    alone, with_clients = measure(clients=0), measure(clients=CLIENTS)
    rows: list[dict[str, Any]] = []
    for name, unit in (("median_ms", "ms"), ("p99_ms", "ms"), ("cores", "cores"), ("lost", "samples")):
        value, baseline = getattr(with_clients["line"], name), getattr(alone["line"], name)
        rows.append(
            {"name": f"{BOARDS} boards, {CLIENTS} OPC UA clients: {name}", "value": value, "unit": unit,
             "baseline": baseline, "ratio": value / baseline if baseline else None, "note": "baseline: no clients"}
        )  # fmt: skip
    rows.append(
        {"name": "OPC UA server", "value": with_clients["cores"], "unit": "cores", "note": f"{CLIENTS} clients"}
    )
    for n, counts in enumerate(with_clients["counts"]):
        rows.append(
            {"name": f"client {n + 1}: values per second and variable", "value": counts["per_s"], "unit": "1/s",
             "note": f"longest interval {counts['longest_ms']:.0f} ms"}
        )  # fmt: skip
    return rows


def measure(*, clients: int) -> dict[str, Any]:
    """One run."""
    with tempfile.TemporaryDirectory(prefix="board51-bench-") as name:
        folder = Path(name)
        endpoint, opcua = f"tcp/127.0.0.1:{line._free_port()}", line._free_port()
        processes = []
        try:
            processes.append(line._start(line.HERE / "load.py", folder, BOARDS, 120))
            line._ready(processes[-1])
            names = [word for n in range(BOARDS) for word in ("--board", f"b{n}={folder}/tty{n}")]
            views = ["--opcua", f"127.0.0.1:{opcua}", "--opcua-rate", "50"] if clients else []
            processes.append(
                line._start("-m", "board51", "gateway", "--site", "bench", *names, "--listen", endpoint,
                            "--log-dir", folder / "logs", *views)
            )  # fmt: skip
            middle = processes[-1]
            line._listening(endpoint)
            processes.append(line._start(line.HERE / "subscriber.py", folder, endpoint))
            line._ready(processes[-1])
            if clients:
                line._listening(f"tcp/127.0.0.1:{opcua}")
                time.sleep(SERVED_S / 4)
                processes.append(line._start(line.HERE / "opcua_clients.py", folder, opcua, clients))
                line._ready(processes[-1])
            time.sleep(line.WARM_S)
            server = _view_of(middle.pid) if clients else 0
            begin, cpu = time.monotonic_ns(), line._cpu_s(middle.pid)
            view_cpu = line._cpu_s(server) if server else 0.0
            time.sleep(line.WINDOW_S)
            view_cpu = (line._cpu_s(server) - view_cpu) if server else 0.0
            end, cpu = time.monotonic_ns(), line._cpu_s(middle.pid) - cpu
            time.sleep(line.TAIL_S)
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                process.wait(timeout=60)
        found: dict[str, Any] = {"line": line._result(folder, begin, end, cpu), "counts": []}
        found["cores"] = view_cpu / line.WINDOW_S
        if clients:
            found["counts"] = json.loads((folder / "counts.json").read_text(encoding="utf-8"))
        return found


def _view_of(gateway: int) -> int:
    """The pid of the gateway's view."""
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            fields = (entry / "stat").read_text(encoding="ascii").rpartition(")")[2].split()
            if int(fields[1]) == gateway and b"gateway.views.child" in (entry / "cmdline").read_bytes():
                return int(entry.name)
    raise RuntimeError("the gateway has no view")


if __name__ == "__main__":
    for row in run():
        print(row)
