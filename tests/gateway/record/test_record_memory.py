"""Memory of a log that is written for years: the index of the open part grows, and goes with the part."""

from __future__ import annotations

import ctypes
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from gateway.bus.publisher import BoardSink, Publisher, Publishers
from gateway.record.recorder import Recorder, RecorderOptions
from gateway.record.writer import LogWriter
from tests.harness.gateway.bus_peers import played_gateway

READS = 300_000  # those of ten minutes of one board
CHUNKS = 4000  # at 10 a second: those of 7 minutes


class Statistics(ctypes.Structure):
    """Glibc's `struct mallinfo2`."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
        )
    ]  # fmt: skip


def allocated() -> int:
    """Bytes that malloc has handed out and not got back, in all arenas; the index is in the library's memory."""
    try:
        statistics = ctypes.CDLL(None).mallinfo2
    except AttributeError:
        pytest.skip("the C library has no mallinfo2")
    statistics.restype = Statistics
    usage = statistics()
    return int(usage.uordblks + usage.hblkhd)


def test_a_part_that_is_closed_leaves_no_index_behind(tmp_path: Path) -> None:
    opened, closed = list[int](), list[int]()
    for part in range(4):
        writer = LogWriter(tmp_path / f"{part}.mcap")
        for chunk in range(CHUNKS):
            writer.write("board51/rig/raw", b"\x00", chunk)
            writer.flush()
        opened.append(allocated())
        writer.close()
        del writer
        closed.append(allocated())

    indexes = [before - after for before, after in zip(opened, closed, strict=True)]
    assert min(indexes) > 100 * CHUNKS  # what is held is seen here
    assert max(indexes) < 1000 * CHUNKS  # gateway/README.md states it
    assert closed[-1] - closed[0] < min(indexes)  # three would have stayed; other threads allocate some, too


def test_a_part_that_is_closed_leaves_no_channels_behind(tmp_path: Path) -> None:
    keys, sizes = [f"board51/rig{n}/raw" for n in range(10)], list[int]()
    for part in range(40):
        writer = LogWriter(tmp_path / f"{part}.mcap")
        for key in keys:
            writer.write(key, b"\x00", part)
        writer.close()
        del writer
        sizes.append(allocated())

    growths = [after - before for before, after in pairwise(sizes[9:])]
    assert median(growths) < 1000 * len(keys)  # bytes a part; it was 6 kB for each channel.  Other threads have bursts


def test_the_bytes_of_the_line_leave_nothing_behind(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(prefix="rig", rotate_bytes=1 << 30, rotate_s=3600.0, queue=10))
    publishers = Publishers(*(Publisher(name, 10) for name in Publishers._fields))
    with played_gateway() as bus:
        sink = BoardSink(bus.session, "board51", "rig", publishers, recorder, log_raw=True)
        sink.raw(bytes(14), 0, to_board=False)
        before = allocated()
        for n in range(READS):
            sink.raw(bytes(14), n, to_board=False)

    assert allocated() - before < READS  # bytes; it was 16 for each read
