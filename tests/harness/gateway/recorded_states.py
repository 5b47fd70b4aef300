"""Samples whose values depend on the tick alone, a recorder for them, and what a log holds of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gateway.record.recorder import OnEvent, Recorder, RecorderOptions
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogRecord
from tests.patience import HANG_S

STATE, PARAMETERS = "board51/rig/state", "board51/rig/parameters"
START_NS = 1_700_000_000_000_000_000


def state(tick: int, *, session: int = 1) -> pb.State:
    """Values that depend on the tick alone, so that a reader can tell wrong data from right."""
    return pb.State(
        sequence=tick & 0xFFFF,
        tick=tick,
        session=session,
        host_time_ns=START_NS + tick * 2_000_000,
        i_c_a=(tick * 7919 % 4096) / 4096,
        x_m=(tick * 104729 % 4096) * 1.4e-6,
        t_s=tick * 0.002,
    )


def put_states(put: Callable[[str, bytes, int], None], ticks: range) -> None:
    for tick in ticks:
        message = state(tick)
        put(STATE, message.SerializeToString(), message.host_time_ns)


def until(condition: Callable[[], bool], *, seconds: float = HANG_S) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)


def ticks(records: Iterator[LogRecord]) -> list[int]:
    numbers = []
    for record in records:
        assert isinstance(record.message, pb.State)
        assert record.message == state(record.message.tick)
        assert record.time_ns == record.message.host_time_ns
        numbers.append(record.message.tick)
    return numbers


def recorder(directory: Path, *, on_event: OnEvent | None = None, **options: Any) -> Recorder:
    settings = {"prefix": "rig", "rotate_bytes": 1 << 30, "rotate_s": 3600.0, "min_free_bytes": 0, **options}
    return Recorder(directory, RecorderOptions(**settings), on_event=on_event)
