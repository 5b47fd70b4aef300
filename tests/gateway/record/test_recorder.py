"""The recorder: parts, queue and folder of a log."""

from __future__ import annotations

import shutil
import threading
import time
from pathlib import Path

import pytest

from gateway.record.writer import LogError
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogReader, read
from tests.harness.gateway.recorded_states import PARAMETERS, START_NS, put_states, recorder, state, ticks, until


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
    logged_ticks = []
    for index, file in enumerate(files):
        scan = LogReader(file)
        records = list(scan.records())
        assert scan.scans[0].finished
        assert scan.metadata["part"]["number"] == str(index)
        assert records[0].topic == "parameters"  # the newest of before, in each part
        logged_ticks += [r.message.tick for r in records if isinstance(r.message, pb.State)]
    assert logged_ticks == list(range(6000))


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
