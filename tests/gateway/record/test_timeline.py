"""The timeline of a log: duration and rigs by the index alone, events and alarms as marks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import board51
from gateway.record.timeline import MAX_MARKS, extent, timeline
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb

START_NS = 1_700_000_000_000_000_000


def write(path: Path, *, infos: int = 1, close: bool = True) -> None:
    """10 s of rig1 and rig2."""
    writer = LogWriter(path)
    for tick in range(11):
        for rig in ("rig1", "rig2"):
            at_ns = START_NS + tick * 10**9
            writer.write(f"board51/{rig}/state", pb.State(tick=tick, host_time_ns=at_ns).SerializeToString(), at_ns)
    at_ns = START_NS + 4 * 10**9
    for _ in range(infos):
        event = pb.Event(name="mode-changed", severity="info", source="board")
        writer.write("board51/rig1/event", event.SerializeToString(), at_ns)
    alarm = pb.Alarm(name="divergence-x", active=True, text="x differs")
    writer.write("board51/rig2/twin/alarm", alarm.SerializeToString(), at_ns + 10**9)
    over = pb.Alarm(name="divergence-x", active=False)
    writer.write("board51/rig2/twin/alarm", over.SerializeToString(), at_ns + 2 * 10**9)
    writer.flush()
    if close:
        writer.close()
    else:
        writer.abandon()


def test_a_finished_log_says_how_long_it_is_and_of_which_rigs(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    write(tmp_path / "open.mcap", close=False)

    known = extent(tmp_path / "a.mcap")

    assert known is not None
    assert (known.boards, known.start_s, known.duration_s) == (("rig1", "rig2"), 1.7e9, 10.0)
    assert extent(tmp_path / "open.mcap") is None
    assert extent(tmp_path / "absent.mcap") is None


@pytest.mark.parametrize("close", [True, False])
def test_events_and_alarms_are_marks(tmp_path: Path, close: bool, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "a.mcap", close=close)

    assert board51.main(["info", str(tmp_path / "a.mcap"), "--marks"]) == 0

    known = json.loads(capsys.readouterr().out)
    assert (known["start_s"], known["duration_s"]) == (1.7e9, 10.0)
    assert [(mark["at_s"], mark["board"], mark["severity"], mark["name"]) for mark in known["marks"]] == [
        (4.0, "rig1", "info", "mode-changed"),
        (5.0, "rig2", "warning", "divergence-x"),
    ]


def test_of_too_many_marks_those_that_only_inform_are_left_out(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", infos=MAX_MARKS + 1)

    assert [mark["name"] for mark in timeline(tmp_path / "a.mcap")["marks"]] == ["divergence-x"]
