"""The archive of logs on a real S3 server: what is copied, what a query finds, what comes back, what faults do."""

from __future__ import annotations

import hashlib
import os
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.record.archive.bucket import Bucket
from gateway.record.archive.copies import SESSIONS, Archiver, Tally, fetch
from gateway.record.catalogue.store import query, selection, update
from gateway.record.retention import DAY_S, delete_expired
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError, ServiceError, UsageError
from protocol.log.reader import LogReader
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.s3_server import BUCKET, KEY, SECRET, S3Server, s3_server
from tests.harness.sites.relay import StallingRelay
from tests.patience import HANG_S

BEGAN_NS = 1_777_593_600_000_000_000  # 2026-05-01 00:00:00 UTC
LARGE = 20_000_000  # bytes: three pieces


@pytest.fixture(scope="module")
def running() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


@pytest.fixture
def server(running: S3Server, monkeypatch: pytest.MonkeyPatch) -> S3Server:
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", KEY)
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    return running


@pytest.fixture
def address(request: pytest.FixtureRequest) -> str:
    """A prefix of its own for each test."""
    return f"s3://{BUCKET}/{request.node.name.replace('[', '/').rstrip(']')}"


def write(path: Path, board: str = "rig1", *, large: bool = False, age_s: float = 60.0) -> Path:
    """A finished log of one session."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draw, writer = random.Random(path.name), LogWriter(path)
    for tick in range(100):
        state = pb.State(tick=tick, session=1, t_s=tick * 0.002, x_m=draw.random())
        writer.write(f"board51/{board}/state", state.SerializeToString(), BEGAN_NS + tick * 2_000_000)
    if large:
        for piece in range(LARGE // 50_000):
            raw = pb.RawBytes(data=draw.randbytes(50_000))
            writer.write(f"board51/{board}/raw", raw.SerializeToString(), BEGAN_NS + 10**9 + piece)
    writer.close()
    grow_old(path, age_s)
    return path


def grow_old(path: Path, age_s: float = 60.0) -> None:
    status = path.stat()
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns - round(age_s * 1e9)))


def archive(folder: Path, address: str, server: S3Server) -> Tally:
    return Archiver(folder, Bucket(address, server.endpoint), lambda text: None).copy()


def addresses(folder: Path, condition: str = "") -> dict[str, str]:
    """Return the address in the archive that the catalogue gives for each file."""
    return dict(query(folder, selection(condition, ("file", "archived"))).rows)


def objects(server: S3Server, address: str) -> dict[str, bytes]:
    """Return the objects that another program finds in the bucket, by name."""
    prefix, store = address.removeprefix(f"s3://{BUCKET}/"), server.store()
    names = [item["path"] for items in store.list(prefix) for item in items]
    return {name.removeprefix(f"{prefix}/"): bytes(store.get(name).bytes()) for name in names}


def command(*words: object, server: str) -> list[str]:
    return [sys.executable, "-m", "board51", "logs", *map(str, words), "--endpoint", server]


def call(*words: object, server: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*words, server=server), env={**os.environ, **environment}, capture_output=True, text=True,
        timeout=HANG_S, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "name", ["board51-20260501T000000Z-000.mcap", "hall 3/größe #1 100%.mcap", "実験/[a]+&=~.mcap"]
)
def test_a_log_that_was_deleted_is_found_by_a_question_and_opened_again(
    name: str, server: S3Server, tmp_path: Path
) -> None:
    address = f"s3://{BUCKET}/a prefix, ü/{hashlib.sha256(name.encode()).hexdigest()}"
    path = write(tmp_path / "logs" / name, "rig7", large=True)
    content, changed_ns = path.read_bytes(), path.stat().st_mtime_ns

    copied = call("archive", tmp_path / "logs", "--to", address, server=server.endpoint)
    path.unlink()
    update(tmp_path / "logs")
    address_of_name = addresses(tmp_path / "logs", "board = 'rig7'")
    fetched = call("fetch", address_of_name[name], "-o", tmp_path / "back", server=server.endpoint)

    assert copied.returncode == 0, copied.stderr
    assert "logs copied: 1 (20." in copied.stderr
    assert address_of_name == {name: f"{address}/{name}"}
    assert fetched.returncode == 0, fetched.stderr
    copy = Path(fetched.stdout.rstrip("\n"))
    assert copy == tmp_path / "back" / path.name
    assert (copy.read_bytes(), copy.stat().st_mtime_ns) == (content, changed_ns)
    assert sum(1 for _ in LogReader(copy).records(topics_=("state",))) == 100


def test_only_what_is_new_or_changed_is_copied(server: S3Server, address: str, tmp_path: Path) -> None:
    first, second = write(tmp_path / "a.mcap"), write(tmp_path / "b.mcap")
    assert archive(tmp_path, address, server)[::2] == (2, 2)
    assert archive(tmp_path, address, server)[::2] == (0, 2)
    grow_old(first)  # the same content
    assert archive(tmp_path, address, server)[::2] == (0, 2)

    content = second.read_bytes()
    second.write_bytes(content[:-20] + bytes(20))  # the same size
    grow_old(second)
    assert archive(tmp_path, address, server)[::2] == (1, 2)
    write(tmp_path / "c.mcap")
    second.unlink()
    write(second, "another rig")
    assert archive(tmp_path, address, server)[::2] == (2, 3)

    assert {name: data for name, data in objects(server, address).items() if name.endswith(".mcap")} == {
        path.name: path.read_bytes() for path in tmp_path.glob("*.mcap")
    }
    assert addresses(tmp_path) == {name: f"{address}/{name}" for name in ("a.mcap", "b.mcap", "c.mcap")}


def test_a_log_that_is_written_waits_and_one_that_is_no_log_is_archived_as_it_is(
    server: S3Server, address: str, tmp_path: Path
) -> None:
    write(tmp_path / "now.mcap", age_s=0.0)
    (tmp_path / "none.mcap").write_bytes(b"no log")
    (tmp_path / "empty.mcap").touch()
    for name in ("none.mcap", "empty.mcap"):
        grow_old(tmp_path / name)

    tally = archive(tmp_path, address, server)

    assert (tally.copied, tally.waiting) == (2, 1)
    assert objects(server, address) == {
        "empty.mcap": b"", "none.mcap": b"no log", f"empty.mcap{SESSIONS}": b"", f"none.mcap{SESSIONS}": b"",
    }  # fmt: skip


def test_what_cannot_be_read_does_not_hold_up_the_others(server: S3Server, address: str, tmp_path: Path) -> None:
    lines = list[str]()
    (tmp_path / "a.mcap").mkdir()
    grow_old(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap")

    tally = Archiver(tmp_path, Bucket(address, server.endpoint), lines.append).copy()

    assert (tally.copied, tally.archived, tally.waiting) == (1, 1, 1)
    assert [line for line in lines if "left out" in line] == [f"{tmp_path / 'a.mcap'} is left out: Is a directory"]
    assert addresses(tmp_path) == {"b.mcap": f"{address}/b.mcap"}


def test_another_machine_learns_from_the_bucket_what_lies_there(
    server: S3Server, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, office = tmp_path / "lab", tmp_path / "office"
    office.mkdir()
    write(lab / "may" / "a.mcap", "rig1")
    write(lab / "b.mcap", "rig2")
    archive(lab, address, server)
    server.store().put(f"{address.removeprefix(f's3://{BUCKET}/')}/alien.mcap", b"of another program")
    server.store().put(f"{address.removeprefix(f's3://{BUCKET}/')}/b.mcap{SESSIONS}", b'{"board": "rig2"}\n[1]\n')

    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "reader")
    tally = archive(office, address, server)

    assert (tally.copied, tally.archived) == (0, 3)
    assert addresses(office) == {"may/a.mcap": f"{address}/may/a.mcap", "b.mcap": f"{address}/b.mcap"}
    columns = ("board", "session", "samples", "began")
    assert query(office, selection("board = 'rig1'", columns)) == query(lab, selection("board = 'rig1'", columns))

    server.store().delete(f"{address.removeprefix(f's3://{BUCKET}/')}/b.mcap")
    archive(office, address, server)
    update(office)
    assert addresses(office).keys() == {"may/a.mcap"}


def test_a_log_that_is_too_old_stays_until_it_is_archived(server: S3Server, address: str, tmp_path: Path) -> None:
    def delete() -> list[tuple[str, str]]:
        return list(delete_expired(tmp_path, "rig", keep_days=1.0, keep_gb=0.0, keep_unarchived=True))

    old, new = (tmp_path / f"rig-20260501T00000{number}Z-000.mcap" for number in range(2))
    for path in (old, new):
        path.write_bytes(b"of no session")
        grow_old(path, 2 * DAY_S)
    ((severity, text),) = delete()
    assert (severity, text.partition(",")[0]) == ("warning", "no log is deleted"), "there is no catalogue"

    archive(tmp_path, address, server)
    new.write_bytes(b"of another one")  # after it was archived
    grow_old(new, 2 * DAY_S)

    assert delete() == [
        ("info", f"{old.name} deleted: older than 1 days"),
        ("warning", "logs kept beyond the bound, as they are not archived yet: 1"),
    ]
    assert [path.name for path in tmp_path.glob("*.mcap")] == [new.name]
    archive(tmp_path, address, server)
    assert delete() == [("info", f"{new.name} deleted: older than 1 days")]


def test_fetch_keeps_what_is_there_and_refuses_what_was_not_archived(
    server: S3Server, address: str, tmp_path: Path
) -> None:
    log, bucket = write(tmp_path / "a.mcap"), Bucket(address, server.endpoint)
    archive(tmp_path, address, server)
    out = tmp_path / "back"
    out.mkdir()

    assert fetch(bucket, "a.mcap", out) == fetch(bucket, "a.mcap", out)
    (out / "a.mcap").write_bytes(b"mine")
    with pytest.raises(UsageError, match=r"a\.mcap exists, with another content"):
        fetch(bucket, "a.mcap", out)
    with pytest.raises(ServiceError, match=r"NoSuchKey.*board51 logs query"):
        fetch(bucket, "b.mcap", out)
    with pytest.raises(UsageError, match="cannot be written"):
        fetch(bucket, "a.mcap", tmp_path / "absent")
    bucket.put("a.mcap", log.read_bytes()[:-1], bucket.attributes("a.mcap"))
    (out / "a.mcap").unlink()
    with pytest.raises(DataError, match="is not what was archived"):
        fetch(bucket, "a.mcap", out)

    assert list(out.iterdir()) == []


def test_a_copy_that_is_killed_leaves_no_part_of_an_object(server: S3Server, address: str, tmp_path: Path) -> None:
    log = write(tmp_path / "a.mcap", large=True)
    with StallingRelay(server.endpoint, LARGE // 2) as line:
        words = command("archive", tmp_path, "--to", address, server=line.endpoint.replace("tcp/", "http://"))
        process = subprocess.Popen(words)
        assert line.stalled.wait(HANG_S)
        process.kill()
        process.wait()

    assert list(objects(server, address)) == [f"a.mcap{SESSIONS}"]
    assert archive(tmp_path, address, server).copied == 1
    assert objects(server, address)["a.mcap"] == log.read_bytes()


def test_a_fetch_that_is_killed_leaves_no_log(server: S3Server, address: str, tmp_path: Path) -> None:
    log, out = write(tmp_path / "a.mcap", large=True), tmp_path / "back"
    archive(tmp_path, address, server)
    with StallingRelay(server.endpoint, LARGE // 2) as line:
        words = command("fetch", f"{address}/a.mcap", "-o", out, server=line.endpoint.replace("tcp/", "http://"))
        process = subprocess.Popen(words)
        assert line.stalled.wait(HANG_S)
        process.kill()
        process.wait()

    assert not (out / "a.mcap").exists()
    fetch(Bucket(address, server.endpoint), "a.mcap", out)
    assert [path.name for path in out.iterdir()] == ["a.mcap"]
    assert (out / "a.mcap").read_bytes() == log.read_bytes()


def test_a_server_that_goes_and_comes_back(address: str, tmp_path: Path, server: S3Server) -> None:
    folder, stderr_file = tmp_path / "logs", tmp_path / "said.txt"
    write(folder / "a.mcap")
    with s3_server() as other:
        words = command("archive", folder, "--to", address, "--every", 0.2, server=other.endpoint)
        with stderr_file.open("w") as sink:
            process = subprocess.Popen(words, stderr=sink)
        try:
            wait_for(lambda: "logs copied: 1" in stderr_file.read_text(), "copy")
            other.kill()
            write(folder / "b.mcap")
            wait_for(lambda: "no answer from the server (Connection refused)" in stderr_file.read_text(), "error")
            other.start()
            wait_for(lambda: stderr_file.read_text().count("logs copied: 1") == 2, "second copy")
        finally:
            process.terminate()
            process.wait()

        assert objects(other, address).keys() >= {"a.mcap", "b.mcap"}
        assert stderr_file.read_text().count("no answer") == 1, "once, not at each pass"


def test_two_that_copy_at_once_do_no_harm(server: S3Server, address: str, tmp_path: Path) -> None:
    logs = [write(tmp_path / f"{number}.mcap", large=number == 0) for number in range(6)]
    words = command("archive", tmp_path, "--to", address, server=server.endpoint)

    both = [subprocess.Popen(words, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    texts = [process.communicate(timeout=HANG_S)[1] for process in both]

    assert [process.returncode for process in both] == [0, 0], texts
    stored = objects(server, address)
    assert {path.name: stored[path.name] for path in logs} == {path.name: path.read_bytes() for path in logs}
    assert archive(tmp_path, address, server)[::2] == (0, 6)


@pytest.mark.parametrize(
    ("environment", "to", "endpoint", "code", "text"),
    [
        (
            {"AWS_SECRET_ACCESS_KEY": "wrong"},
            "",
            "",
            1,
            "SignatureDoesNotMatch: .*Correct AWS_SECRET_ACCESS_KEY or AWS_ACCESS_KEY_ID",
        ),
        pytest.param(
            {"AWS_ACCESS_KEY_ID": "nobody"},
            "",
            "",
            1,
            "InvalidAccessKeyId: .*Correct AWS_ACCESS_KEY_ID",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"AWS_ACCESS_KEY_ID": "reader"},
            "",
            "",
            1,
            r"a\.mcap.*AccessDenied: .*right to list, read and write",
            marks=pytest.mark.slow,
        ),
        ({"AWS_ACCESS_KEY_ID": ""}, "", "", 2, "AWS_ACCESS_KEY_ID not set. Set"),
        ({}, "s3://absent/logs", "", 1, "s3://absent/logs: .*NoSuchBucket: .*Create the bucket"),
        ({}, "", "http://127.0.0.1:1", 1, r"no answer from the server \(Connection refused\)\. Look at --endpoint"),
        pytest.param(
            {}, "", "http://absent.invalid", 1, "no answer from the server .*Look at --endpoint", marks=pytest.mark.slow
        ),
        pytest.param({}, "", "https://", 1, "no answer from the server.*https or http", marks=pytest.mark.slow),
        pytest.param({}, "", "127.0.0.1:9000", 2, "127.0.0.1:9000 is not an endpoint", marks=pytest.mark.slow),
        pytest.param(
            {}, "plant/logs", "", 2, "plant/logs is not the address of a bucket. Write s3://", marks=pytest.mark.slow
        ),
        pytest.param({}, "s3://plant/a//b", "", 1, "s3://plant/a//b: .*empty path segment", marks=pytest.mark.slow),
        pytest.param(
            {"AWS_CA_BUNDLE": "/absent.pem"},
            "",
            "",
            2,
            "AWS_CA_BUNDLE=/absent.pem cannot be read",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_error_says_what_is_wrong_and_what_to_do(
    environment: dict[str, str], to: str, endpoint: str, code: int, text: str, server: S3Server, tmp_path: Path
) -> None:
    write(tmp_path / "a.mcap")
    where = server.endpoint.replace("http://", endpoint) if endpoint == "https://" else endpoint or server.endpoint

    process = call("archive", tmp_path, "--to", to or f"s3://{BUCKET}/errors", server=where, **environment)

    assert process.returncode == code, process.stderr
    *progress, error = process.stderr.splitlines()
    assert all(re.match(r"\[1/1\] a\.mcap", line) for line in progress)
    assert error.startswith("board51 logs: ")
    assert re.search(text, error), error
