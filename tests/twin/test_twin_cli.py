"""`board51 twin` and `board51 plot` as typed: logs in; summary, log and picture out; one line on bad input."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import board51
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogReader
from tests.harness.twin.rig import G, M, Rig
from tests.patience import HANG_S
from twin.model.parameters import Model
from twin.readers.log import TwinLog, entries, parse

HELD = 2.85e-3


def write_log(path: Path, rig: Rig, *, board: str = "rig", ticks: int = 1500, parameters: bool = True) -> None:
    with TwinLog(path) as log:
        add(log, rig, board=board, ticks=ticks, parameters=parameters)


def add(log: TwinLog, rig: Rig, *, board: str, ticks: int, parameters: bool = True) -> None:
    if parameters:
        log.write(f"lab/{board}/parameters", rig.parameters(), message_type=pb.Parameters, log_time_ns=10**18)
    rig.hold(HELD)
    for state in rig.run(ticks, lambda k: HELD if (k // 300) % 2 else 3.4e-3):
        log.write(f"lab/{board}/state", state, message_type=pb.State, log_time_ns=state.host_time_ns)


def wrong_rig() -> Rig:
    return Rig(K_c=M * G / 120.364**2, gap_offset_m=2.4377e-3)


@pytest.fixture(scope="module")
def right_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("right") / "right.mcap"
    write_log(path, Rig())
    return path


def refused(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert board51.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_a_log_gives_a_summary(right_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["twin", "--log", str(right_log), "--json"]) == 0

    result = json.loads(capsys.readouterr().out)
    (board,) = result["boards"]
    assert result["complete"]
    assert board["samples"] == 1500
    assert board["in_step"] + board["settling"] + board["out_of_step"] == 1500
    assert 5e-6 < board["rmse"]["x_m"] < 8e-6
    assert 1.7 < board["nis_mean"] < 2.3
    assert board["alarms"] == []


def test_a_wrong_model_can_fail_a_build(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(tmp_path / "wrong.mcap", wrong_rig())

    assert board51.main(["twin", "--log", str(tmp_path / "wrong.mcap"), "--fail-on-alarm"]) == 1

    out = capsys.readouterr().out
    assert "alarm ON  innovation" in out
    assert "alarm ON  divergence-i_c" in out


def test_the_written_log_holds_the_samples_and_the_twin_and_gives_the_same_bits_again(
    right_log: Path, tmp_path: Path
) -> None:
    outs = [tmp_path / "one.mcap", tmp_path / "two.mcap"]

    assert board51.main(["twin", "--log", str(right_log), "--out", str(outs[0])]) == 0
    assert board51.main(["twin", "--log", str(outs[0]), "--out", str(outs[1])]) == 0

    topics = ("state", "twin/state", "twin/divergence")
    first, second = ([(e.topic, e.data) for e in entries(LogReader(out), topics=topics)] for out in outs)
    assert first == second
    assert [t for t, _ in first].count("twin/divergence") == 1500
    assert [t for t, _ in first].count("twin/state") == 1499  # the first sample of a running loop starts nothing yet


def test_a_log_without_the_law_is_observed_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(tmp_path / "bare.mcap", Rig(), parameters=False)

    assert board51.main(["twin", "--log", str(tmp_path / "bare.mcap"), "--json"]) == 0

    (board,) = json.loads(capsys.readouterr().out)["boards"]
    assert board["in_step"] == 0
    assert board["rmse"]["x_m"] is None
    assert board["innovations"] > 1400
    assert 1.7 < board["nis_mean"] < 2.3


def test_an_unfinished_log_is_read_as_far_as_it_goes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    long = tmp_path / "long.mcap"
    with TwinLog(long) as log:
        add(log, Rig(), board="rig", ticks=16_000)  # more than one chunk
    cut = tmp_path / "cut.mcap"
    data = long.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])

    assert board51.main(["twin", "--log", str(cut), "--json"]) == 0

    result = json.loads(capsys.readouterr().out)
    assert not result["complete"]
    assert 5_000 < result["boards"][0]["samples"] < 16_000


@pytest.mark.parametrize("content", [b"", b"not a log, but long enough to have a magic", bytes(100)])
def test_what_is_no_log_is_refused(content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.mcap").write_bytes(content)

    assert "x.mcap" in refused(["twin", "--log", str(tmp_path / "x.mcap")], capsys)


def test_a_damaged_log_is_refused(right_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(right_log.read_bytes())
    data[1000] ^= 0xFF  # in the first chunk: the index of messages between two chunks may be damaged without a loss
    (tmp_path / "damaged.mcap").write_bytes(data)

    assert "recover" in refused(["twin", "--log", str(tmp_path / "damaged.mcap")], capsys)


def test_a_foreign_message_under_our_key_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with TwinLog(tmp_path / "x.mcap") as log:
        log.write("lab/rig/state", pb.Event(name="x"), message_type=pb.Event, log_time_ns=1)

    assert "holds board51.v1.Event" in refused(["twin", "--log", str(tmp_path / "x.mcap")], capsys)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["twin", "--log", "nowhere.mcap"], "nowhere.mcap"),
        (["twin", "--log", "{log}", "--board", "other"], "Boards in this log: rig"),
        (["twin", "--log", "{log}", "--board", "A/B"], "is not a name"),
        (["twin", "--log", "{log}", "--model", "nowhere.json"], "nowhere.json"),
        (["twin", "--log", "{log}", "--out", "{log}"], "cannot be written"),
        (["twin", "--log", "{log}", "--window", "0"], "--window 0 is outside"),
        (["twin", "--log", "{log}", "--false-alarms-per-day", "nan"], "--false-alarms-per-day nan"),
        (["twin", "--json"], "are for a log"),
        (["twin", "--connect", "localhost"], "not a zenoh endpoint"),
        (["plot", "{log}", "--out", "x.txt"], "unknown kind of picture"),
        (["plot", "{log}", "--out", "/nowhere/x.png"], "cannot be written"),
        (["plot", "{log}", "--out", "{tmp}/x.png", "--from", "99"], "no samples between"),
    ],
)
def test_bad_usage_is_one_line(
    arguments: list[str], says: str, right_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    filled = [a.format(log=right_log, tmp=tmp_path) for a in arguments]

    assert says in refused(filled, capsys)


def test_a_model_file_is_used(right_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = Model.load("ce152").to_json()
    model["parameters"]["K_c"]["value"] *= 1.2
    (tmp_path / "model.json").write_text(json.dumps(model))

    assert board51.main(["twin", "--log", str(right_log), "--model", str(tmp_path / "model.json"), "--json"]) == 0

    (board,) = json.loads(capsys.readouterr().out)["boards"]
    assert board["nis_mean"] > 10.0


@pytest.mark.slow
def test_a_picture_is_drawn_from_a_log_with_and_without_twin_topics(
    right_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with_twin = tmp_path / "with.mcap"
    board51.main(["twin", "--log", str(right_log), "--out", str(with_twin)])
    capsys.readouterr()

    for log, source in ((right_log, "the model ce152"), (with_twin, "the twin that was logged")):
        picture = tmp_path / f"{log.stem}.png"

        assert board51.main(["plot", str(log), "--out", str(picture), "--json"]) == 0

        result = json.loads(capsys.readouterr().out)
        assert result["twin"] == source
        assert result["samples"] == 1500
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert picture.stat().st_size > 30_000


def test_a_picture_without_a_name_has_that_of_its_log(
    right_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    assert board51.main(["plot", str(right_log)]) == 0

    assert (tmp_path / f"{right_log.stem}.png").read_bytes().startswith(b"\x89PNG")


def test_a_log_of_two_boards_asks_which(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.mcap"
    with TwinLog(path) as log:
        for board in ("one", "two"):
            add(log, Rig(), board=board, ticks=200)

    assert "one, two" in refused(["plot", str(path), "--out", str(tmp_path / "x.png")], capsys)
    assert board51.main(["plot", str(path), "--out", str(tmp_path / "x.png"), "--board", "two"]) == 0


@pytest.mark.slow
def test_the_live_command_ends_cleanly_on_sigterm() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "board51", "twin", "--connect", "tcp/127.0.0.1:1"], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    assert "twin of model ce152" in process.stderr.readline()  # it waits for a router that is not there

    process.send_signal(signal.SIGTERM)
    _, rest = process.communicate(timeout=HANG_S)

    assert process.returncode == 0
    assert "stopped" in rest


def test_an_entry_that_is_no_message_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with TwinLog(tmp_path / "x.mcap") as log:
        log.write("lab/rig/state", b"\xff\xff\xff", message_type=pb.State, log_time_ns=1)
    entry = next(entries(LogReader(tmp_path / "x.mcap"), topics=("state",)))

    with pytest.raises(Exception, match="lab/rig/state"):
        parse(pb.State, entry, tmp_path / "x.mcap")
    assert "is damaged" in refused(["twin", "--log", str(tmp_path / "x.mcap")], capsys)
