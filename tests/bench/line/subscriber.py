"""A subscriber in a process of its own: when did which sample arrive?

python subscriber.py FOLDER ENDPOINT      writes FOLDER/arrived.npy at SIGTERM: rows board, tick, CLOCK_MONOTONIC ns
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.bus.identity import find_identity


def main(folder: Path, endpoint: str) -> None:
    """Collect until SIGTERM."""
    gc.disable()  # its pauses would be counted as the latency of what is measured
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    arrived: list[tuple[int, str, bytes]] = []

    def take(sample: zenoh.Sample) -> None:
        arrived.append((time.monotonic_ns(), str(sample.key_expr), sample.payload.to_bytes()))

    identity = find_identity(None)  # BOARD51_IDENTITY, where the bus is guarded
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=[endpoint], identity=identity))) as session:
        session.declare_subscriber("bench/*/state", take)
        print("ready", flush=True)
        stop.wait()
    rows = [(int(key.split("/")[1][1:]), pb.State.FromString(data).tick, at) for at, key, data in arrived]
    np.save(folder / "arrived.npy", np.array(rows, np.int64).reshape(-1, 3))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
