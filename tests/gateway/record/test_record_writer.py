"""The writer: what is put is in the file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from gateway.record.writer import Compression, LogError, LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.log.reader import LogReader, read
from tests.harness.gateway.recorded_states import STATE, put_states, state, ticks

REPO = Path(__file__).parents[3]


@pytest.mark.parametrize("compression", ["lz4", "zstd", "none"])
def test_another_reader_finds_messages_schema_and_metadata(tmp_path: Path, compression: Compression) -> None:
    log = tmp_path / "a.mcap"
    writer = LogWriter(log, metadata={"config": {"boards": "rig"}}, compression=compression)

    put_states(writer.write, range(1000))
    writer.close()

    with log.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        messages = list(reader.iter_messages())
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("config", {"boards": "rig"})]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 1000
    assert [(s.name, s.encoding, s.data) for s in summary.schemas.values()] == [
        ("board51.v1.State", "protobuf", encoding.descriptor_set())
    ]
    assert [channel.topic for _, channel, _ in messages] == [STATE] * 1000
    assert [pb.State.FromString(message.data) for _, _, message in messages] == [state(tick) for tick in range(1000)]
    assert [message.log_time for _, _, message in messages] == [state(tick).host_time_ns for tick in range(1000)]


def test_two_writers_do_not_mix(tmp_path: Path) -> None:
    first, second = LogWriter(tmp_path / "1.mcap"), LogWriter(tmp_path / "2.mcap")

    put_states(first.write, range(0, 100))
    put_states(second.write, range(100, 200))
    first.close()
    put_states(second.write, range(200, 300))
    second.close()

    assert ticks(read(tmp_path / "1.mcap")) == list(range(0, 100))
    assert ticks(read(tmp_path / "2.mcap")) == list(range(100, 300))


def test_what_was_flushed_is_readable_while_the_file_grows(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap")

    put_states(writer.write, range(50))
    writer.flush()
    put_states(writer.write, range(50, 60))  # still in memory

    assert ticks(read(tmp_path / "a.mcap")) == list(range(50))
    writer.close()


def test_a_large_log_goes_to_disk_without_a_flush(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", compression="none")

    put_states(writer.write, range(70_000))  # about 6 MB

    assert writer.bytes_written > 4_000_000
    writer.close()
    assert ticks(read(tmp_path / "a.mcap")) == list(range(70_000))


def test_an_existing_file_is_not_touched(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(b"precious")

    with pytest.raises(LogError, match="exists already"):
        LogWriter(log)

    assert log.read_bytes() == b"precious"


def test_a_foreign_key_is_refused(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap")
    with pytest.raises(ValueError, match="board51/rig/nonsense"):
        writer.write("board51/rig/nonsense", b"", 0)
    writer.close()


def test_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    writer = LogWriter(tmp_path / "a.mcap")
    put_states(writer.write, range(10))
    writer.close()

    assert capfd.readouterr() == ("", "")


_LIMITED = """
import resource, sys
from pathlib import Path
from gateway.record.writer import LogError, LogWriter
from protocol.bus import board51_pb2 as pb
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
writer = LogWriter(Path(sys.argv[1]))
written = flushed = 0
try:
    while True:
        for _ in range(20):
            writer.write("board51/rig/state", pb.State(tick=written, x_m=written * 1e-6).SerializeToString(), written)
            written += 1
        writer.flush()
        flushed = written
except LogError as error:
    print(error.reason, flushed, written, Path(sys.argv[1]).stat().st_size)
if len(sys.argv) > 2:
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    writer.close()
"""


@pytest.mark.parametrize("goes_on", [False, True])
def test_a_refused_write_leaves_whole_chunks_and_can_be_repeated(tmp_path: Path, goes_on: bool) -> None:
    log = tmp_path / "a.mcap"
    arguments = [sys.executable, "-c", _LIMITED, str(log), *(["on"] if goes_on else [])]

    process = subprocess.run(arguments, cwd=REPO, capture_output=True, text=True, check=True)

    reason, flushed, written, size = process.stdout.split()[-4:]
    assert "file too large" in process.stdout
    assert process.stderr == ""
    assert int(size) <= 20_000
    expected = int(written) if goes_on else int(flushed)
    assert [record.message.tick for record in read(log) if isinstance(record.message, pb.State)] == list(
        range(expected)
    )
    reader = LogReader(log)
    assert sum(1 for _ in reader.raw()) == expected
    assert reader.scans[0].damages == []
    assert reader.scans[0].finished is goes_on
    assert reason == "large"
