"""Old logs: which are deleted, that it is said, and that the one in work never is."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from gateway.record.recorder import Recorder, RecorderOptions
from gateway.record.retention import DAY_S, RECENT_S, Log, expired
from tests.patience import HANG_S

NOW_S = 1e9


def names(logs: list[tuple[str, float, int]], *, keep_days: float = 0.0, keep_gb: float = 0.0) -> list[str]:
    parts = [Log(Path(name), NOW_S - age_s, size) for name, age_s, size in logs]
    return [path.name for path, _ in expired(parts, NOW_S, keep_days=keep_days, keep_gb=keep_gb)]


@pytest.mark.parametrize(
    ("bounds", "deleted"),
    [
        ({}, []),
        ({"keep_days": 2.0}, ["old", "older"]),
        ({"keep_gb": 2.5}, ["old"]),
        ({"keep_gb": 1.5}, ["old", "older"]),
        ({"keep_gb": 0.001}, ["old", "older", "yesterday"]),
        ({"keep_days": 1e-6}, ["old", "older", "yesterday"]),
    ],
)
def test_the_oldest_go_first_and_never_the_one_in_work(bounds: dict[str, float], deleted: list[str]) -> None:
    gb = 1_000_000_000
    ages = [("yesterday", DAY_S, gb), ("now", RECENT_S / 2, gb // 10), ("old", 9 * DAY_S, gb), ("older", 3 * DAY_S, gb)]

    assert names(ages, **bounds) == deleted


def test_a_recorder_deletes_its_own_old_logs_and_says_so(tmp_path: Path) -> None:
    old = ("rig-20200101T000000Z-000.mcap", "rig-notes.mcap", "other-20200101T000000Z-000.mcap")
    for name in old:
        (tmp_path / name).write_bytes(b"x")
        os.utime(tmp_path / name, (NOW_S, NOW_S))
    events: list[tuple[str, str, str]] = []
    options = RecorderOptions(prefix="rig", rotate_bytes=10**9, rotate_s=3600.0, keep_days=30.0)
    log = Recorder(tmp_path, options, on_event=lambda *event: events.append(event))

    log.start()
    end_s = time.monotonic() + HANG_S
    while not events and time.monotonic() < end_s:
        time.sleep(0.01)
    log.close()

    assert events[0] == ("log-deleted", "info", f"{old[0]} deleted: older than 30 days")
    assert {path.name for path in tmp_path.iterdir()} == {*old[1:], log.files[0].name}
