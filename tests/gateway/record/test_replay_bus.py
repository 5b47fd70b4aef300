"""A log back onto the bus, and the bus into a log: every message, byte for byte, in order and in time."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

import board51
from gateway.record.replay import SESSIONS_PER_PASS, from_time
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.log.reader import LogReader
from tests.harness.soak.stage import Disk
from tests.patience import HANG_S

REPO = Path(__file__).parents[3]
START_NS = 1_700_000_000_000_000_000
Arrived = tuple[str, str, bytes]  # key, encoding, payload


def until(condition: Callable[[], bool], *, seconds: float = HANG_S) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)


@pytest.fixture
def endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


@contextmanager
def subscriber(endpoint: str) -> Iterator[list[Arrived]]:
    """The router, with everything that arrives."""
    arrivals: list[Arrived] = []

    def arrived(sample: zenoh.Sample) -> None:
        arrivals.append((str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes()))

    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:
        session.declare_subscriber("board51/**", arrived)
        yield arrivals


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """1000 ticks with everything that a gateway and a twin leave."""
    writer = LogWriter(tmp_path / "run.mcap")
    parameters = pb.Parameters(session=1, sample_time_s=0.002, host_time_ns=START_NS)
    writer.write("board51/rig/parameters", parameters.SerializeToString(), START_NS)
    for tick in range(1000):
        now_ns = START_NS + tick * 2_000_000
        state = pb.State(sequence=tick, tick=tick, session=1, host_time_ns=now_ns, x_m=tick * 1e-6, t_s=tick * 0.002)
        writer.write("board51/rig/raw", pb.RawBytes(data=b"\x00", host_time_ns=now_ns).SerializeToString(), now_ns)
        writer.write("board51/rig/state", state.SerializeToString(), now_ns)
        writer.write("board51/rig/twin/state", pb.TwinState(tick=tick, x_m=1.0).SerializeToString(), now_ns)
    writer.close()
    return tmp_path / "run.mcap"


def logged(log: Path, *topics: str) -> list[tuple[str, bytes]]:
    return [(record.key, record.data) for record in LogReader(log).raw(topics_=topics or None)]


def test_a_fast_replay_sends_the_log_and_nothing_else(
    log: Path, endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with subscriber(endpoint) as arrivals:
        assert board51.main(["replay", str(log), "--speed", "0", "--connect", endpoint, "--json"]) == 0
        until(lambda: len(arrivals) >= 2001)

    recorded = [(key, payload) for key, _, payload in arrivals if not key.endswith("/states")]
    batches = [pb.StateBatch.FromString(payload) for key, _, payload in arrivals if key.endswith("/states")]
    assert recorded == logged(log, "parameters", "state")
    assert [state.SerializeToString() for batch in batches for state in batch.states] == [p for _, p in recorded[1:]]
    assert {encoding.partition("v1.")[2] for _, encoding, _ in arrivals} == {"Parameters", "State", "StateBatch"}
    report = json.loads(capsys.readouterr().out)
    assert report["messages"] == 1001
    assert report["log_seconds"] == pytest.approx(1.998)


def test_choices_apply(log: Path, endpoint: str) -> None:
    options = ["--speed", "0", "--start", "0.5", "--end", "0.6", "--topic", "twin/state", "--as", "ghost"]
    with subscriber(endpoint) as arrivals:
        assert board51.main(["replay", str(log), "--connect", endpoint, *options]) == 0
        until(lambda: len(arrivals) >= 100)

    states = [pb.TwinState.FromString(payload) for key, _, payload in arrivals if key == "board51/ghost/twin/state"]
    batches = [pb.TwinBatch.FromString(payload) for key, _, payload in arrivals if key == "board51/ghost/twin/states"]
    assert [state.tick for state in states] == list(range(250, 300))
    assert batches == [pb.TwinBatch(states=[state]) for state in states]


def test_each_pass_of_a_loop_has_its_own_session(log: Path, endpoint: str) -> None:
    with subscriber(endpoint) as arrivals:
        process = subprocess.Popen(
            [sys.executable, "board51.py", "replay", str(log), "--speed", "0", "--loop", "--connect", endpoint],
            cwd=REPO, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        until(lambda: len(arrivals) > 5000)
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=HANG_S)

    assert process.returncode == 0
    assert "messages" in output
    states = [pb.State.FromString(payload) for key, _, payload in arrivals if key.endswith("/state")]
    assert {state.session for state in states[:2000]} == {1, 1 + SESSIONS_PER_PASS}
    assert [state.tick for state in states[:2000]] == [*range(1000), *range(1000)]


def test_a_living_board_is_not_overwritten(log: Path, endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:
        with session.liveliness().declare_token("board51/rig/alive"):
            assert board51.main(["replay", str(log), "--connect", endpoint, "--wait", "0"]) == 1

    assert "board51/rig is alive on this bus. Replay under another name (--as NAME)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--speed", "-1"], "not a speed"),
        (["--connect", "localhost"], "not a zenoh endpoint"),
        (["--topic", "twin/alarm"], "has no messages of twin/alarm"),
        (["--board", "other"], "has no messages of other"),
        (["--as", "Two Words"], "is not a name"),
        (["--pty", "/tmp/x"], "take bytes"),
        (["--connect", "tcp/127.0.0.1:1", "--listen", "tcp/127.0.0.1:1"], "exclude each other"),
    ],
)
def test_wrong_use_is_told_in_one_line(
    log: Path, options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert board51.main(["replay", str(log), *options]) == 2

    error_output = capsys.readouterr().err
    assert says in error_output
    assert error_output.count("\n") == 1


def test_record_logs_what_a_replay_sends(log: Path, endpoint: str, tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))):
        process = subprocess.Popen(
            [sys.executable, "board51.py", "record", "-o", str(logs), "--connect", endpoint],
            cwd=REPO, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stderr is not None
        assert "recording board51/*/**" in process.stderr.readline()
        options = ["--speed", "0", "--topic", "parameters", "--topic", "state", "--topic", "twin/state"]
        assert board51.main(["replay", str(log), "--connect", endpoint, *options]) == 0
        until(lambda: any(_size(file) > 3000 for file in logs.iterdir()))
        until(_quiet(logs))
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=HANG_S)

    assert process.returncode == 0
    assert "2001 messages in 1 part(s), 0 dropped" in output
    recorded = LogReader(next(logs.iterdir()))
    assert recorded.scans[0].indexed
    assert [(r.key, r.data) for r in recorded.raw()] == logged(log, "parameters", "state", "twin/state")
    times = {r.time_ns for r in recorded.raw(topics_=["state"])}
    assert times == {START_NS + tick * 2_000_000 for tick in range(1000)}  # the gateway's time, not this host's


def test_record_begins_on_a_full_disk_and_writes_when_there_is_room(log: Path, endpoint: str, tmp_path: Path) -> None:
    disk = Disk(tmp_path / "disk")
    if not disk.mounted:
        pytest.skip("no right to mount a small disk")
    (disk.folder / "ballast").write_bytes(bytes(4096))
    disk.fill(leave=0)
    process = None
    try:
        with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))):
            process = subprocess.Popen(
                [sys.executable, "board51.py", "record", "-o", str(disk.folder), "--connect", endpoint],
                cwd=REPO, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            assert process.stderr is not None
            lines = [process.stderr.readline(), process.stderr.readline()]
            options = ["--speed", "0", "--topic", "state"]
            assert board51.main(["replay", str(log), "--connect", endpoint, *options]) == 0
            disk.free()
            lines.append(process.stderr.readline())
            (part,) = disk.folder.glob("*.mcap")
            until(lambda: _size(part) > 3000)
            until(_quiet(disk.folder))
            process.send_signal(signal.SIGTERM)
            output, rest = process.communicate(timeout=HANG_S)
        ticks = [pb.State.FromString(record.data).tick for record in LogReader(part).raw(topics_=["state"])]
    finally:
        if process is not None:
            process.kill()
        disk.close()

    assert "disk full. Free space on that file system until 60 MB are free; logging then continues" in lines[0]
    assert lines[1] == f"recording board51/*/** into {disk.folder}\n"
    assert lines[2] == f"log-resumed: Logging into {part.name}\n"
    assert (output, rest) == ("1000 messages in 1 part(s), 0 dropped\n", "")
    assert ticks == list(range(1000))


def _size(file: Path) -> int:
    return os.stat(file).st_size


def _quiet(logs: Path) -> Callable[[], bool]:
    """True once the log has not grown for 0.3 s."""
    last_change = [0, time.monotonic()]

    def check() -> bool:
        size = sum(_size(file) for file in logs.iterdir())
        if size != last_change[0]:
            last_change[:] = [size, time.monotonic()]
        return time.monotonic() - last_change[1] > 0.3

    return check


def test_from_a_time_on_what_is_repeated_comes_first(log: Path) -> None:
    reader = LogReader(log)

    records = list(from_time(reader, 1.0, topics_=("state", "parameters"), boards=None, end_s=1.01))

    assert [(record.topic, record.time_ns - START_NS) for record in records[:2]] == [
        ("parameters", 1_000_000_000),
        ("state", 1_000_000_000),
    ]
    assert all(record.topic == "state" for record in records[1:])
    assert list(from_time(reader, 1e3, topics_=("state", "parameters"), boards=None, end_s=None)) == []
