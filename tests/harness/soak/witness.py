"""Subscribers of a soak, each a process of its own.

python -m tests.harness.soak.witness ENDPOINT FILE.npy     writes at SIGTERM what was published: board, number, ns
python -m tests.harness.soak.witness ENDPOINT --slow       takes 50 ms for a message, and keeps nothing
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np
import zenoh
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from tests.harness.soak.names import GHOST, PLANT
from tests.harness.soak.numbered_board import numbers_of

LOOK_S = 0.5
_SLOW_S = 0.05


def rows_of(arrived: list[tuple[int, str, bytes]]) -> NDArray[np.int64]:
    """Board (n of rig n, -1 - n of a replay of it), sample, CLOCK_MONOTONIC ns of each sample in these messages."""
    boards, times, i_c, x = list[int](), list[int](), list[float](), list[float]()
    for at_ns, key, payload in arrived:
        name = key.split("/")[1]
        if name == PLANT:
            continue
        board = -1 - int(name.removeprefix(GHOST)) if name.startswith(GHOST) else int(name.removeprefix("rig"))
        for state in pb.StateBatch.FromString(payload).states:
            boards.append(board)
            times.append(at_ns)
            i_c.append(state.i_c_a)
            x.append(state.x_m)
    return np.stack([np.array(boards, np.int64), numbers_of(np.array(i_c), np.array(x)), np.array(times, np.int64)], 1)


def main(endpoint: str, out: str) -> None:
    """Collect until SIGTERM."""
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    arrived: deque[tuple[int, str, bytes]] = deque()

    def take(sample: zenoh.Sample) -> None:
        if out == "--slow":
            time.sleep(_SLOW_S)
        else:
            arrived.append((time.monotonic_ns(), str(sample.key_expr), sample.payload.to_bytes()))

    parts = [np.zeros((0, 3), np.int64)]
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=[endpoint]))) as session:
        session.declare_subscriber("board51/*/states", take)
        print("ready", flush=True)
        while not stop.wait(LOOK_S):
            if arrived:
                parts.append(rows_of([arrived.popleft() for _ in range(len(arrived))]))
    if out != "--slow":
        parts.append(rows_of(list(arrived)))
        np.save(Path(out), np.concatenate(parts))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
