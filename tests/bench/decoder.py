"""Decoder: frames per second against what one would write first, and damaged frames that pass.

python tests/bench/decoder.py [--damaged 10000000]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

if __name__ == "__main__":  # run as a file: the packages lie two levels up
    sys.path.insert(0, str(Path(__file__).parents[2]))

from protocol.wire.codec import BODY_SIZE, encode_body
from protocol.wire.decoder import BadFrame, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROWS, Field, Row, Value

SEED = 51
STREAM_FRAMES = 40_000
BASELINE_FRAMES = 4_000  # the baseline is ten times slower: about the same time for both
CHUNK = 4096  # bytes per read, as a busy gateway sees them
BATCH = 50_000  # damaged frames per call of `feed`
TEMPLATES = 2_000  # different frames of each type
STATE_SHARE = 0.8  # of the damaged frames; the other types share the rest

Bytes = npt.NDArray[np.uint8]


class FirstTry:
    """The decoder that one would write first: byte by byte, CRC bit by bit, fields into a dict."""

    def __init__(self) -> None:
        self.buffer: list[int] = []

    def feed(self, data: bytes) -> list[dict[str, int]]:
        frames = []
        for byte in data:
            if byte:
                self.buffer.append(byte)
                continue
            if self.buffer:
                fields = self.decode(self.buffer)
                if fields is not None:
                    frames.append(fields)
            self.buffer = []
        return frames

    @staticmethod
    def decode(stuffed: list[int]) -> dict[str, int] | None:
        data: list[int] = []
        at = 0
        while at < len(stuffed):
            code = stuffed[at]
            for n in range(1, code):
                if at + n >= len(stuffed):
                    return None
                data.append(stuffed[at + n])
            at += code
            if at < len(stuffed):
                data.append(0)
        crc = 0xFFFF
        for byte in data:
            crc ^= byte << 8
            for _ in range(8):
                crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
        if crc or len(data) != 12 or data[0] != 0x40:
            return None
        return {
            "sequence": data[1] | data[2] << 8,
            "i_c": data[3] | (data[4] & 15) << 8,
            "x": data[4] >> 4 | data[5] << 4,
            "u_c": data[6] | (data[7] & 15) << 8,
            "x_ref": data[7] >> 4 | data[8] << 4,
            "flags": data[9],
        }


def _value(rng: np.random.Generator, field: Field) -> Value:
    if field.type == "f32":
        return float(np.float32(rng.normal()))
    if field.type.startswith("bytes"):
        return rng.bytes(int(field.type[5:]))
    assert field.low is not None
    assert field.high is not None
    value = int(rng.integers(int(field.low), int(field.high) + 1))
    return value & ~1 if field.type == "flags" else value  # mode 0 or 2


def random_frame(rng: np.random.Generator, row: Row) -> bytes:
    """A good frame of `row` with arbitrary contents."""
    return encode_frame(encode_body(row.name, **{field.name: _value(rng, field) for field in row.fields}))


def _chunks(stream: bytes) -> list[bytes]:
    return [stream[at : at + CHUNK] for at in range(0, len(stream), CHUNK)]


def _rate(feed: Callable[[bytes], list[Any]], chunks: list[bytes], frames: int) -> tuple[float, int]:
    """(frames sent per second, events that came out), the best of three runs: the machine is shared."""
    best, events = float("inf"), 0
    for _ in range(3):
        start = time.perf_counter()
        events = sum(len(feed(chunk)) for chunk in chunks)
        best = min(best, time.perf_counter() - start)
    return frames / best, events


def noisy(rng: np.random.Generator, frames: list[bytes]) -> bytes:
    """A stream of `frames` in which one frame in ten has a flipped bit, and one gap in ten up to 20 bytes of noise."""
    parts = []
    for frame in frames:
        damaged = bytearray(frame)
        if rng.random() < 0.1:
            damaged[rng.integers(len(frame))] ^= 1 << int(rng.integers(8))
        parts.append(bytes(damaged))
        if rng.random() < 0.1:
            parts.append(rng.bytes(int(rng.integers(1, 21))))
    return b"".join(parts)


def throughput(row_name: str, make_stream: Callable[[list[bytes]], bytes]) -> dict[str, Any]:
    """Return one row of the result: our decoder and the first try on the same kind of stream, in the same run."""
    rng = np.random.default_rng(SEED)
    state = next(row for row in ROWS if row.name == "STATE")
    frames = [random_frame(rng, state) for _ in range(STREAM_FRAMES)]
    rate, events = _rate(StreamDecoder().feed, _chunks(make_stream(frames)), len(frames))
    first_frames = frames[:BASELINE_FRAMES]
    baseline, _ = _rate(FirstTry().feed, _chunks(make_stream(first_frames)), len(first_frames))
    return {
        "name": row_name,
        "value": round(rate),
        "unit": "frames/s",
        "baseline": round(baseline),
        "ratio": round(rate / baseline, 1),
        "note": f"STATE frames in reads of {CHUNK} bytes, {events} events from {len(frames)} frames; "
        "baseline: byte by byte, CRC bit by bit, fields in a dict",
    }


def damaged_batches(total: int, seed: int = SEED) -> Iterator[tuple[bytes, int]]:
    """Streams of damaged frames and how many each holds; in all `total`, of all types.

    Every frame has one to three different bits flipped, anywhere in it: delimiters and COBS codes too.  An idle
    delimiter on both sides keeps the damage of two neighbours from adding up to more than three flips.
    """
    rng = np.random.default_rng(seed)
    other_rows = [row for row in ROWS if row.name != "STATE"]
    shares = {row.name: (1 - STATE_SHARE) / len(other_rows) for row in other_rows} | {"STATE": STATE_SHARE}
    counts = {name: int(total * share) for name, share in shares.items()}
    counts["STATE"] += total - sum(counts.values())
    for row in ROWS:
        templates = np.array(
            [np.frombuffer(random_frame(rng, row), np.uint8) for _ in range(min(TEMPLATES, counts[row.name]))], np.uint8
        )
        for begin in range(0, counts[row.name], BATCH):
            count = min(BATCH, counts[row.name] - begin)
            yield damage(rng, templates[rng.integers(len(templates), size=count)]), count


def damage(rng: np.random.Generator, frames: Bytes) -> bytes:
    """`frames`, shape (count, size), each with 1 to 3 different bits flipped and an idle delimiter on both sides."""
    count, size = frames.shape
    flips = rng.integers(1, 4, size=count)
    bits = rng.integers(8 * size, size=(count, 3))
    # A bit drawn twice would flip back; the third may then equal another one, so it is moved again.
    bits[:, 1] = (bits[:, 1] + (bits[:, 1] == bits[:, 0])) % (8 * size)
    while (same := (bits[:, 2] == bits[:, 0]) | (bits[:, 2] == bits[:, 1])).any():
        bits[:, 2] = (bits[:, 2] + same) % (8 * size)
    rows = np.arange(count)
    for n in range(3):
        mask = (1 << (bits[:, n] % 8)).astype(np.uint8)
        frames[rows, bits[:, n] // 8] ^= np.where(flips > n, mask, 0).astype(np.uint8)
    return np.pad(frames, ((0, 0), (1, 1))).tobytes()


def count_accepted(total: int, seed: int = SEED) -> tuple[int, dict[str, int]]:
    """Damaged frames that the decoder took for good ones, and what it called the others, by cause."""
    accepted, causes = 0, dict[str, int]()
    decoder = StreamDecoder()
    for stream, _ in damaged_batches(total, seed):
        for event in decoder.feed(stream):
            if isinstance(event, BadFrame):
                causes[event.cause] = causes.get(event.cause, 0) + 1
            else:
                accepted += 1
    return accepted, causes


def run(damaged: int = 10_000_000) -> list[dict[str, Any]]:
    """All rows: name, value, unit, baseline, ratio, note."""
    rng = np.random.default_rng(SEED)
    rows = [
        throughput("decoder, clean stream", b"".join),
        throughput("decoder, noisy stream", lambda frames: noisy(rng, frames)),
    ]
    start = time.perf_counter()
    accepted, causes = count_accepted(damaged)
    seconds = time.perf_counter() - start
    rejected = ", ".join(f"{cause} {count}" for cause, count in sorted(causes.items()))
    rows.append(
        {
            "name": "damaged frames accepted",
            "value": accepted,
            "unit": f"of {damaged:.0e}".replace("e+0", "e"),
            "baseline": round(damaged / 65536),  # what a 16-bit check passes of arbitrary bytes
            "ratio": None,
            "note": f"1 to 3 bits flipped anywhere, all {len(BODY_SIZE)} types, {seconds:.0f} s; rejected: {rejected}; "
            "baseline: arbitrary bytes and a 16-bit CRC alone",
        }
    )
    return rows


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--damaged", type=int, default=10_000_000, help="damaged frames to send (default 1e7)")
    for row in run(parser.parse_args().damaged):
        ratio = "" if row["ratio"] is None else f", ratio {row['ratio']}"
        print(f"{row['name']}: {row['value']:,} {row['unit']} (baseline {row['baseline']:,}{ratio})\n    {row['note']}")


if __name__ == "__main__":
    main()
