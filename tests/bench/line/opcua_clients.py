"""OPC UA clients: `opcua_clients.py FOLDER PORT COUNT BOARDS`; each subscribes 20 variables of one board at 50 Hz.

Prints `ready`; counts from SIGUSR1 on; on SIGTERM writes counts.json with what came, per client: values per second and
variable, and the longest interval of source time of any variable in ms.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

from asyncua import Client, Node, ua

VARIABLES = [
    *(f"state/{name}{end}" for name in ("i_c_a", "x_m", "u_c_v", "x_ref_m") for end in ("", "/min", "/max")),
    *(f"state/{n}" for n in ("tick", "sequence", "t_s", "mode", "host_time_ns", "flags", "session", "lost_before")),
]
INTERVAL_MS = 100.0  # publishing; the values come 5 at a time
SERVED_S = 60.0
PATIENCE_S = 60.0  # asyncua's own second is too short where eight processes share two cores: the client would go


class Counter:
    """Counts one client's values by variable."""

    def __init__(self) -> None:
        self.values = 0
        self.longest_ms = 0.0
        self._last: dict[Any, Any] = {}

    def datachange_notification(self, node: Any, _: Any, data: Any) -> None:
        self.values += 1
        stamp = data.monitored_item.Value.SourceTimestamp
        last = self._last.get(node.nodeid)
        if last is not None and stamp is not None:
            self.longest_ms = max(self.longest_ms, (stamp - last).total_seconds() * 1e3)
        self._last[node.nodeid] = stamp

    def status_change_notification(self, status: Any) -> None:
        pass


async def served(node: Node) -> None:
    """Wait until the server has made it, the last of all: eight boards have 3000 nodes."""
    end_s = time.monotonic() + SERVED_S
    while True:
        try:
            await node.read_browse_name()
            return
        except ua.UaStatusCodeError:
            if time.monotonic() > end_s:
                raise
        await asyncio.sleep(0.1)


async def main(folder: Path, port: int, count: int, boards: int) -> None:
    begin, stop = asyncio.Event(), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, begin.set)
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    counters = [Counter() for _ in range(count)]
    clients = []
    for n, counter in enumerate(counters):
        client = Client(f"opc.tcp://127.0.0.1:{port}/board51/", timeout=30, watchdog_intervall=PATIENCE_S)
        await client.connect()
        clients.append(client)
        index = await client.get_namespace_index("urn:board51:bench")
        await served(client.get_node(ua.NodeId(f"b{boards - 1}/{VARIABLES[0]}", index)))
        subscription = await client.create_subscription(INTERVAL_MS, counter)
        nodes = [client.get_node(ua.NodeId(f"b{n}/{path}", index)) for path in VARIABLES]
        each = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)  # also what did not change
        await subscription._subscribe(nodes, mfilter=each, queuesize=100)
    print("ready", flush=True)
    await begin.wait()
    for counter in counters:
        counter.values, counter.longest_ms = 0, 0.0
    start_s = time.monotonic()
    await stop.wait()
    per_s = 1.0 / (time.monotonic() - start_s) / len(VARIABLES)
    counts = [{"per_s": counter.values * per_s, "longest_ms": counter.longest_ms} for counter in counters]
    (folder / "counts.json").write_text(json.dumps(counts), encoding="utf-8")
    for client in clients:
        await client.disconnect()


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    os.nice(int(os.environ.get("BOARD51_BENCH_NICE", "0")))
    asyncio.run(main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
