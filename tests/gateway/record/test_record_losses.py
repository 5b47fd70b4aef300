"""A full disk and a kill cost a log as little as they must."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.record.recover import recover
from gateway.record.writer import LogError
from protocol.log.reader import LogReader, read
from tests.harness.gateway.recorded_states import put_states, recorder, ticks, until

REPO = Path(__file__).parents[3]


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
    assert [logged_tick for file in files for logged_tick in ticks(read(file))] == list(range(tick + 100))


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
from tests.harness.gateway.recorded_states import STATE, state
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
        [sys.executable, "-c", _KILLED, str(logs)],
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
