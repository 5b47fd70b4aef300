"""Writer and recorder: what is put is in the file, whatever happens to disk, queue or process."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from gateway.record.recorder import OnEvent, Recorder, RecorderOptions
from gateway.record.recover import recover
from gateway.record.writer import Compression, LogError, LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.log.reader import LogReader, LogRecord, read
from tests.patience import HANG_S

STATE, PARAMETERS = "board51/rig/state", "board51/rig/parameters"
START_NS = 1_700_000_000_000_000_000
REPO = Path(__file__).parents[3]


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
    found = []
    for record in records:
        assert isinstance(record.message, pb.State)
        assert record.message == state(record.message.tick)
        assert record.time_ns == record.message.host_time_ns
        found.append(record.message.tick)
    return found


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
    one, two = LogWriter(tmp_path / "1.mcap"), LogWriter(tmp_path / "2.mcap")

    put_states(one.write, range(0, 100))
    put_states(two.write, range(100, 200))
    one.close()
    put_states(two.write, range(200, 300))
    two.close()

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

    done = subprocess.run(arguments, cwd=REPO, capture_output=True, text=True, check=True)

    reason, flushed, written, size = done.stdout.split()[-4:]
    assert "file too large" in done.stdout
    assert done.stderr == ""
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


def recorder(directory: Path, *, on_event: OnEvent | None = None, **options: Any) -> Recorder:
    settings = {"prefix": "rig", "rotate_bytes": 1 << 30, "rotate_s": 3600.0, "min_free_bytes": 0, **options}
    return Recorder(directory, RecorderOptions(**settings), on_event=on_event)


def test_parts_stand_alone(tmp_path: Path) -> None:
    events: list[tuple[str, str]] = []
    log = recorder(tmp_path, rotate_bytes=40_000, on_event=lambda name, severity, _: events.append((name, severity)))
    log.start()

    for number in range(3):
        parameters = pb.Parameters(board_id=number, host_time_ns=START_NS + number)
        log.put(PARAMETERS, parameters.SerializeToString(), parameters.host_time_ns)
        parts = log.stats().parts
        put_states(log.put, range(number * 2000, (number + 1) * 2000))
        until(lambda before=parts: log.stats().parts > before)  # type: ignore[misc]  # mypy cannot infer a default argument
    log.close()

    files = sorted(tmp_path.iterdir())
    assert len(files) >= 4
    assert all(file.name.startswith("rig-") and file.suffix == ".mcap" for file in files)
    assert ("log-rotated", "info") in events
    found = []
    for index, file in enumerate(files):
        scan = LogReader(file)
        records = list(scan.records())
        assert scan.scans[0].finished
        assert scan.metadata["part"]["number"] == str(index)
        assert records[0].topic == "parameters"  # the newest of before, in each part
        found += [r.message.tick for r in records if isinstance(r.message, pb.State)]
    assert found == list(range(6000))


def test_a_part_is_closed_by_age(tmp_path: Path) -> None:
    log = recorder(tmp_path, rotate_s=0.2)
    log.start()

    put_states(log.put, range(10))
    until(lambda: log.stats().parts == 2)
    time.sleep(0.5)  # nothing comes: an empty part is not replaced by another
    assert log.stats().parts == 2
    log.close()


@pytest.mark.parametrize("how", ["deleted", "moved", "replaced", "its directory deleted"])
def test_a_part_that_goes_while_it_is_written_is_told_and_followed_by_another(tmp_path: Path, how: str) -> None:
    directory, elsewhere, events = tmp_path / "logs", tmp_path / "moved.mcap", list[tuple[str, str]]()
    directory.mkdir()
    log = recorder(directory, on_event=lambda name, severity, _: events.append((name, severity)))
    log.start()
    first = directory / log.stats().file
    put_states(log.put, range(10))
    until(lambda: first.stat().st_size > 1000)

    if how == "deleted":
        first.unlink()
    elif how == "moved":
        first.rename(elsewhere)
    elif how == "replaced":
        elsewhere.touch()
        elsewhere.replace(first)
    else:
        shutil.rmtree(directory)
        until(lambda: log.stats().state.startswith("failed"))
        directory.mkdir()
    until(lambda: log.stats().state == "writing" and log.stats().file not in ("", first.name))
    second = directory / log.stats().file
    put_states(log.put, range(10, 20))
    log.close()

    assert ("log-removed", "fault") in events
    assert ticks(read(second)) == list(range(10, 20))
    if how == "moved":
        assert ticks(read(elsewhere)) == list(range(10))
        assert LogReader(elsewhere).scans[0].indexed


def test_names_never_collide(tmp_path: Path) -> None:
    logs = [recorder(tmp_path) for _ in range(3)]

    for log in logs:
        log.start()
    for log in logs:
        put_states(log.put, range(5))
        log.close()

    assert len([ticks(read(file)) for file in tmp_path.iterdir()]) == 3


def test_a_full_queue_drops_the_oldest_and_counts(tmp_path: Path) -> None:
    events: list[str] = []
    log = recorder(tmp_path, queue=100, on_event=lambda name, *_: events.append(name))

    put_states(log.put, range(250))  # the thread does not run yet
    assert (log.stats().depth, log.stats().dropped, log.stats().state) == (100, 150, "off")
    log.start()
    log.close()

    assert ticks(read(next(tmp_path.iterdir()))) == list(range(150, 250))
    assert log.stats().dropped == 150
    assert events == ["log-dropping"]


def test_many_threads_may_put(tmp_path: Path) -> None:
    log = recorder(tmp_path, queue=100_000)
    log.start()

    def work(board: int) -> None:
        for tick in range(2000):
            message = state(tick)
            log.put(f"board51/b{board}/state", message.SerializeToString(), message.host_time_ns)

    threads = [threading.Thread(target=work, args=(board,)) for board in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    log.close()

    assert log.stats().dropped == 0
    for board in range(4):
        assert ticks(read(next(tmp_path.iterdir()), boards=[f"b{board}"])) == list(range(2000))


def test_a_bad_key_costs_only_itself(tmp_path: Path) -> None:
    log = recorder(tmp_path)
    log.start()

    put_states(log.put, range(5))
    log.put("nonsense", b"", 0)
    put_states(log.put, range(5, 10))
    log.close()

    assert ticks(read(next(tmp_path.iterdir()))) == list(range(10))
    assert log.stats().parts == 1


def test_a_failing_callback_does_not_end_the_log(tmp_path: Path) -> None:
    def fails(*_: str) -> None:
        raise RuntimeError("not ours")

    log = recorder(tmp_path, rotate_bytes=1000, on_event=fails)
    log.start()
    put_states(log.put, range(500))
    until(lambda: log.stats().parts >= 2)
    put_states(log.put, range(500, 600))
    log.close()

    assert [t for f in sorted(tmp_path.iterdir()) if f.stat().st_size > 600 for t in ticks(read(f))] == list(range(600))


@pytest.mark.parametrize(("directory", "says"), [("absent", "no such directory"), ("file", "not a directory")])
def test_a_directory_that_is_none_is_told_at_the_start(tmp_path: Path, directory: str, says: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match=says):
        recorder(tmp_path / directory).start()


def test_a_read_only_directory_is_told_at_the_start() -> None:
    with pytest.raises(LogError) as caught:
        recorder(Path("/proc/self")).start()  # not even root may create a file there
    assert caught.value.exit_code == 1


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 400 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", str(disk)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a small file system cannot be mounted here: {mounted.stderr.strip()}")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)  # a test that failed has files open there


@pytest.mark.parametrize("min_free_bytes", [0, 60_000], ids=["to-the-last-byte", "with-a-reserve"])
def test_a_full_disk_is_told_and_logging_resumes_without_loss(small_disk: Path, min_free_bytes: int) -> None:
    events: list[str] = []
    log = recorder(small_disk, min_free_bytes=min_free_bytes, on_event=lambda name, *_: events.append(name))
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(200_000))
    log.start()

    tick = 0
    while log.stats().state == "writing":
        put_states(log.put, range(tick, tick + 50))
        tick += 50
        time.sleep(0.005)
    assert log.stats().state == "disk-full"
    put_states(log.put, range(tick, tick + 100))  # while it is full
    tick += 100
    until(lambda: bool(events))
    assert events == ["log-disk-full"]
    ballast.unlink()
    until(lambda: log.stats().state == "writing")
    put_states(log.put, range(tick, tick + 100))
    log.close()

    assert events == ["log-disk-full", "log-resumed"]
    assert log.stats().dropped == 0
    files = sorted(small_disk.iterdir())
    assert len(files) == 2
    assert all(LogReader(file).scans[0].indexed for file in files)  # the cut part got its end, too
    assert [found for file in files for found in ticks(read(file))] == list(range(tick + 100))


@pytest.mark.parametrize("full", ["of-bytes", "of-files"])
def test_a_disk_that_is_full_at_the_start_delays_the_log(small_disk: Path, full: str) -> None:
    events: list[tuple[str, str, str]] = []
    log = recorder(small_disk, on_event=lambda *event: events.append(event))
    ballast = small_disk / "ballast"
    if full == "of-bytes":
        with pytest.raises(OSError, match="No space left"):
            ballast.write_bytes(bytes(1 << 20))
    else:
        ballast.touch()
        subprocess.run(["mount", "-o", "remount,nr_inodes=2", str(small_disk)], check=True)  # the folder, the ballast
    handles = os.listdir("/proc/self/fd")
    with pytest.raises(LogError, match="disk full"):
        log.start(needs_room=True)
    left = os.listdir(small_disk), os.listdir("/proc/self/fd")

    log.start()
    put_states(log.put, range(100))
    state = log.stats().state
    ballast.unlink()
    until(lambda: log.stats().state == "writing")
    log.close()

    assert left == (["ballast"], handles)
    assert state == "disk-full"
    (file,) = small_disk.iterdir()
    assert ticks(read(file)) == list(range(100))
    assert file.name.endswith("-000.mcap")
    assert [name for name, _, _ in events] == ["log-disk-full", "log-resumed"]
    assert events[0][2].endswith("disk full. Free space on that file system; logging then continues by itself.")


_KILLED = """
import sys, time
from pathlib import Path
from gateway.record.recorder import Recorder, RecorderOptions
from protocol.bus import board51_pb2 as pb
sys.path.insert(0, sys.argv[2])
from test_record_writer import STATE, state
log = Recorder(
    Path(sys.argv[1]), RecorderOptions(prefix="rig", rotate_bytes=1 << 30, rotate_s=3600.0, min_free_bytes=0)
)
log.start()
tick = 0
begin = time.monotonic()
while True:
    while tick < (time.monotonic() - begin) * 500.0:
        log.put(STATE, state(tick).SerializeToString(), state(tick).host_time_ns)
        tick += 1
    sys.stdout.write(f"{tick}\\n")
    sys.stdout.flush()
    time.sleep(0.001)
"""


@pytest.mark.parametrize("seed", range(6))
def test_kill_9_costs_at_most_250_ms(tmp_path: Path, seed: int) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", _KILLED, str(logs), str(Path(__file__).parent)],
        cwd=REPO, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(REPO)},
    )  # fmt: skip
    assert process.stdout is not None
    process.stdout.readline()

    time.sleep(random.Random(seed).uniform(0.5, 1.2))
    process.send_signal(signal.SIGKILL)
    put = int(process.stdout.read().split()[-1])
    process.wait()
    process.stdout.close()

    broken, clean = next(logs.iterdir()), tmp_path / "clean.mcap"
    result = recover(broken, clean)
    saved = ticks(read(clean))
    assert saved == list(range(len(saved)))  # no wrong data, no holes
    assert (put - len(saved)) * 0.002 <= 0.250
    assert result.messages == len(saved)
    assert not result.was_finished
    assert LogReader(clean).scans[0].indexed
