"""Log: messages/s and bytes per sample of our writer and reader against the plain `mcap` package in the same run.

The baseline writes with its default settings (1 MiB chunks, zstd): what a program does that does not think of kill -9,
which costs it everything since its last chunk (about 20 s at 500 Hz).  Ours gives the system a chunk every 0.1 s.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer

from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.log.reader import LogReader

KEY = "board51/rig/state"
START_NS = 1_700_000_000_000_000_000
SAMPLES = 100_000
PER_FLUSH = 50  # 0.1 s at 500 Hz
REPEATS = 3  # the best of: a shared machine only ever makes things slower
Row = dict[str, Any]


def run() -> list[Row]:
    """Write and read the same 200 s of samples with both; rows for `board51 bench`."""
    messages = [_sample(tick) for tick in range(SAMPLES)]
    with tempfile.TemporaryDirectory() as folder:
        log_path, plain = Path(folder) / "ours.mcap", Path(folder) / "plain.mcap"
        write_s = min(_timed(_write_log, log_path, messages) for _ in range(REPEATS))
        write_plain_s = min(_timed(_write_plain, plain, messages) for _ in range(REPEATS))
        read_s = min(_timed(_read_log, log_path) for _ in range(REPEATS))
        read_plain_s = min(_timed(_read_plain, plain) for _ in range(REPEATS))
        size, size_plain = log_path.stat().st_size / SAMPLES, plain.stat().st_size / SAMPLES
    return [
        _row("write", SAMPLES / write_s, SAMPLES / write_plain_s, "messages/s", "ours flushes every 50 messages"),
        _row("read and parse", SAMPLES / read_s, SAMPLES / read_plain_s, "messages/s", "both parse protobuf"),
        _row("size", size, size_plain, "bytes/sample", "lz4 in 0.1 s chunks against zstd in 1 MiB chunks"),
    ]


def _row(name: str, value: float, baseline: float, unit: str, note: str) -> Row:
    return {"name": name, "value": value, "unit": unit, "baseline": baseline, "ratio": value / baseline, "note": note}


def _sample(tick: int) -> tuple[int, bytes]:
    """Return a sample like one of a rig in closed loop: converter counts in SI, slow signals with noise."""
    now_ns = START_NS + tick * 2_000_000
    noise = (tick * 104_729 % 17) - 8
    state = pb.State(
        sequence=tick & 0xFFFF, tick=tick, session=1, host_time_ns=now_ns + noise * 9_973,
        i_c_a=0.6 + 3.7e-4 * noise, x_m=2.85e-3 + 1e-3 * math.sin(tick * 0.006) + 1.4e-6 * noise,
        u_c_v=2.1 + 1.2e-3 * noise, x_ref_m=2.85e-3 if tick % 2000 < 1000 else 3.85e-3,
        mode=pb.MODE_CLOSED_LOOP, t_s=tick * 0.002,
    )  # fmt: skip
    return now_ns, state.SerializeToString()


def _timed(work: Any, *arguments: Any) -> float:
    begin = time.perf_counter()
    work(*arguments)
    return time.perf_counter() - begin


def _write_log(path: Path, messages: list[tuple[int, bytes]]) -> None:
    path.unlink(missing_ok=True)
    writer = LogWriter(path)
    for number, (now_ns, data) in enumerate(messages, 1):
        writer.write(KEY, data, now_ns)
        if number % PER_FLUSH == 0:
            writer.flush()
    writer.close()


def _write_plain(path: Path, messages: list[tuple[int, bytes]]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(encoding.schema_name(pb.State), "protobuf", encoding.descriptor_set())
        channel = writer.register_channel(KEY, "protobuf", schema)
        for now_ns, data in messages:
            writer.add_message(channel, now_ns, data, now_ns)
        writer.finish()


def _read_log(path: Path) -> None:
    count = sum(1 for _ in LogReader(path).records(topics_=["state"]))
    assert count == SAMPLES


def _read_plain(path: Path) -> None:
    with path.open("rb") as file:
        count = 0
        for _, _, message in make_reader(file).iter_messages(topics=[KEY]):
            pb.State.FromString(message.data)
            count += 1
    assert count == SAMPLES
