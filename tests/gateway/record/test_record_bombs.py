"""Logs that unpack to far more than they are: refused before decompression, with what is intact delivered."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard

import board51
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.log.reader import LogReader
from protocol.log.scan import MAGIC, Scan

SIZE = 1 << 28
MAX_BYTES = 150_000_000  # bytes of memory; the largest bombs hold 268 MB


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(packed: bytes, *, name: str, size: int, crc: int) -> bytes:
    head = struct.pack("<QQQI", 0, 1 << 62, size, crc) + text(name)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def plain_chunk(records: bytes) -> bytes:
    return chunk(records, name="", size=len(records), crc=zlib.crc32(records))


def states(first: int, *, count: int = 20) -> bytes:
    out = []
    for tick in range(first, first + count):
        state = pb.State(sequence=tick, tick=tick, session=1, host_time_ns=tick * 2_000_000, t_s=tick * 0.002, x_m=1e-3)
        head = struct.pack("<HIQQ", 1, tick, tick * 2_000_000, tick * 2_000_000)
        out.append(record(5, head + state.SerializeToString()))
    return b"".join(out)


def described(records: bytes) -> bytes:
    schema = record(3, struct.pack("<H", 1) + text("board51.v1.State") + text("protobuf") + text(""))
    channel = record(4, struct.pack("<HH", 1, 1) + text("board51/rig/state") + text("protobuf") + text(""))
    return plain_chunk(schema + channel + records)


def zstd(content: bytes, times: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    return b"".join(packer.compress(content) for _ in range(times)) + packer.flush()


def lz4_(content: bytes, times: int) -> bytes:
    packer = lz4.frame.LZ4FrameCompressor()
    parts = [packer.begin(), *(packer.compress(content) for _ in range(times)), packer.flush()]
    return b"".join(parts)


MB = bytes(1 << 20)
BOMBS: dict[str, Callable[[], tuple[bytes, str]]] = {
    "lz4 too large": lambda: (chunk(lz4_(MB, 256), name="lz4", size=SIZE, crc=1), "unpacks to 268435456 bytes"),
    "zstd too large": lambda: (chunk(zstd(MB, 256), name="zstd", size=SIZE, crc=1), "unpacks to 268435456 bytes"),
    "lz4 that says 1000": lambda: (chunk(lz4_(MB, 256), name="lz4", size=1000, crc=1), "more than the 1000 bytes"),
    "zstd that says 1000": lambda: (chunk(zstd(MB, 256), name="zstd", size=1000, crc=1), "more than the 1000 bytes"),
    "zstd that states its size inside": lambda: (
        chunk(zstandard.ZstdCompressor(level=1).compress(bytes(SIZE)), name="zstd", size=1000, crc=1),
        "more than the 1000 bytes",
    ),
    "opcode 0": lambda: (chunk(zstd(MB, 16), name="zstd", size=16 << 20, crc=0), "a malformed record"),
    "small chunks of zeros": lambda: (
        chunk(zstd(MB, 16), name="zstd", size=16 << 20, crc=0) * 300,
        "unpacks to more than 100 times its size",
    ),
    "records of nothing": lambda: (record(3, b"") * 20_000, "a malformed record"),
}


@pytest.fixture(scope="module", params=BOMBS)
def bomb(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, str]:
    """A log with intact chunks before and after the bomb, its offset, and what is to be said."""
    log = tmp_path_factory.mktemp("bomb") / "bomb.mcap"
    between, says = BOMBS[request.param]()
    before = MAGIC + record(1, text("") + text("test")) + described(states(0))
    end = record(0x0F, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC
    log.write_bytes(before + between + plain_chunk(states(20)) + end)
    return log, len(before), says


def test_a_bomb_costs_itself_and_no_memory(bomb: tuple[Path, int, str]) -> None:
    log, offset, says = bomb
    scan = Scan(log)
    tracemalloc.start()

    ticks = [encoding.parse(pb.State, message.data) for message in scan.messages()]

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [state.tick for state in ticks if state] == list(range(40))
    assert scan.damages[0].offset == offset
    assert says in " ".join(damage.reason for damage in scan.damages)
    assert sum(damage.bytes for damage in scan.damages) < log.stat().st_size
    assert len(scan.damages) <= 2
    assert scan.finished
    assert peak < MAX_BYTES


def test_a_bomb_cut_off_is_no_bomb(bomb: tuple[Path, int, str], tmp_path: Path) -> None:
    log, offset, _ = bomb
    cut = tmp_path / "cut.mcap"
    whole = log.read_bytes()
    cut.write_bytes(whole[: offset + (len(whole) - offset) // 2])
    tracemalloc.start()

    count = sum(1 for _ in Scan(cut).messages())

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count >= 20
    assert peak < MAX_BYTES


def test_every_command_names_file_place_and_remedy(
    bomb: tuple[Path, int, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, offset, says = bomb
    clean = tmp_path / "clean.mcap"

    assert board51.main(["info", str(log)]) == 1
    assert f"DAMAGED bomb.mcap at byte {offset}" in capsys.readouterr().out
    assert board51.main(["recover", str(log), "-o", str(clean)]) == 0
    out = capsys.readouterr().out
    assert "40 messages from" in out
    assert says in out
    assert len(list(LogReader(clean).records())) == 40
    for command in (["export", str(log), "-o", str(tmp_path / "a.csv")], ["twin", "--log", str(log)]):
        assert board51.main(command) == 2
        err = capsys.readouterr().err
        assert f"{log} is damaged at byte {offset}" in err
        assert f"board51 recover {log}" in err


def test_many_damaged_chunks_are_searched_once(tmp_path: Path) -> None:
    """With a search for each of them, the work would grow with the square of their number."""
    chunks = [plain_chunk(states(20 * number)) for number in range(400)]
    damaged = [part[:-1] + bytes([part[-1] ^ 1]) for part in chunks]
    log = tmp_path / "damaged.mcap"
    log.write_bytes(MAGIC + described(b"") + b"".join(damaged) + plain_chunk(states(8000)))
    scan = Scan(log)

    delivered = sum(1 for _ in scan.messages())

    assert delivered == 20
    assert scan.damages[0].bytes == sum(map(len, damaged))
    assert scan.unpacked < 3 * log.stat().st_size
