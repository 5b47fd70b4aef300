"""`board51 campaign run` on an emulated rig behind a real gateway: what is recorded, and every way it can end."""

from __future__ import annotations

import json
import signal
from itertools import pairwise
from pathlib import Path

import pytest

from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from protocol.log.reader import LogReader
from tests.harness.gateway.campaign_line import emulated_line, standings, summary
from tests.harness.gateway.gateway_peers import wait_for
from tests.patience import HANG_S

STEPS = ("--quick", "--experiment", "steps", "--json")
SHORT = ("--quick", "--experiment", "rest", "--experiment", "amplifier-steps", "--experiment", "steps", "--json")


@pytest.mark.slow
def test_a_campaign_is_recorded_continued_and_left_parked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "c"
    with emulated_line(tmp_path) as line:
        code = line.run(folder, *SHORT)
        first = summary(capsys)
        (folder / "rest.mcap").write_bytes(b"half")
        repaired = line.run(folder, *SHORT)
        second = summary(capsys)
        added = line.run(folder, "--quick", "--experiment", "wide-steps-judge", "--json")
        line.assert_parked()

    assert (code, repaired, added) == (0, 0, 0)
    assert list(standings(first)) == ["lift-off", "rest", "amplifier-steps", "steps"]  # the lift-off input was needed
    assert set(standings(first).values()) == {"recorded"}
    assert standings(second) == {"rest": "recorded", "amplifier-steps": "already-there", "steps": "already-there"}
    assert first["lift_off_v"] == pytest.approx(3.30, rel=0.08)  # read behind the departure, on a ramp of 4 V/s
    assert sum(row["seconds"] for row in first["experiments"]) < first["rig_s"] < 60.0
    campaign = load(folder)
    assert [(r.file, r.kind, r.use) for r in campaign.recordings] == [
        ("lift-off.mcap", "sawtooth", "fit"),
        ("rest.mcap", "amplifier-step", "fit"),
        ("amplifier-steps.mcap", "amplifier-step", "fit"),
        ("steps.mcap", "closed-loop", "fit"),
        ("wide-steps-judge.mcap", "closed-loop", "judge"),
    ]
    assert campaign.plant.x_max_m == 8.138e-3
    assert campaign.controller is not None
    assert campaign.controller.gains == pytest.approx((0.49, 1700.0, 17.7, -17600.0), rel=1e-4)


@pytest.mark.slow
def test_a_recording_holds_what_is_needed_to_understand_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with emulated_line(tmp_path) as line:
        assert line.run(tmp_path / "c", "--quick", "--experiment", "amplifier-steps", "--who", "anna") == 0

    reader = LogReader(tmp_path / "c" / "amplifier-steps.mcap")
    records = [record for record in reader.records()]
    message_of_topic = {record.topic: record.message for record in records}
    states = [record.message for record in records if isinstance(record.message, pb.State)]
    assert {record.topic for record in records[:2]} == {"plant", "parameters"}
    assert {"state", "capture", "event", "command/record"} <= set(message_of_topic)
    assert isinstance(message_of_topic["command/record"], pb.CommandRecord)
    assert message_of_topic["command/record"].command.who == "anna"
    assert [b.tick - a.tick for a, b in pairwise(states)] == [1] * (len(states) - 1)
    assert reader.metadata["campaign"]["experiment"] == "amplifier-steps"
    assert "the ball lifts off at" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_an_interrupted_campaign_leaves_the_ball_parked_and_goes_on(number: signal.Signals, tmp_path: Path) -> None:
    folder = tmp_path / "c"
    with emulated_line(tmp_path) as line:
        process = line.start(folder, *STEPS)
        wait_for(lambda: line.bus.states()[-1].mode == pb.MODE_CLOSED_LOOP, "flight")
        process.send_signal(number)
        out, err = process.communicate(timeout=HANG_S)
        line.assert_parked()
        table = json.loads(out)
        left = json.loads((folder / "run.json").read_text())["left"]

        code = line.run(folder, *STEPS)

    assert process.returncode == 1, err
    assert standings(table)["steps"] == "interrupted"
    assert table["interrupted"]
    assert table["parked"]
    assert f"To continue: board51 campaign run {folder}" in err
    assert "Traceback" not in err
    assert code == 0
    assert left == ["steps"]
    assert json.loads((folder / "run.json").read_text())["left"] == []
    assert sorted(path.name for path in folder.iterdir()) == ["campaign.toml", "run.json", "steps.mcap"]


@pytest.mark.slow
def test_another_plan_or_rig_is_not_mixed_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lift_off = ("--quick", "--experiment", "lift-off")
    with emulated_line(tmp_path) as line:

        def refused(*more: str) -> str:
            assert line.run(tmp_path / "c", *more) == 2
            return capsys.readouterr().err

        assert line.run(tmp_path / "c", *lift_off) == 0
        capsys.readouterr()
        assert "--seed was 1, is 2" in refused(*lift_off, "--seed", "2")
        assert "the limit u_max_v was 4.999, is 4.5" in refused(*lift_off, "--u-max", "4.5")
        assert "its steps differ (with and without --quick" in refused("--experiment", "lift-off")

        line.plant.write_text("[plant]\nmass_kg = 9e-3\ntravel_m = 5.7e-3\n")
        assert "is of another plant: name was ce152" in refused(*lift_off)


@pytest.mark.slow
def test_a_board_that_somebody_flies_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with emulated_line(tmp_path, speed=1.0) as line:
        line.bus.command("fly", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP))
        wait_for(lambda: line.bus.states()[-1].mode == pb.MODE_CLOSED_LOOP, "flight")

        assert line.run(tmp_path / "c") == 1

        assert "rig is in closed loop: another user works with it" in capsys.readouterr().err
        assert line.bus.states()[-1].mode == pb.MODE_CLOSED_LOOP

        assert line.run(tmp_path / "c", "--quick", "--experiment", "rest", "--park") == 0
        line.assert_parked()


@pytest.mark.slow
def test_a_tighter_gateway_is_obeyed_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from gateway.config import LimitsConfig

    with emulated_line(tmp_path, limits=LimitsConfig(u_max_v=2.0)) as line:
        assert line.run(tmp_path / "c", "--quick", "--experiment", "rest") == 1
        line.assert_parked()

    err = capsys.readouterr().err
    assert "outside the gateway's limits, at most 2 V" in err
    assert "the lift-off input is not known" in err


@pytest.mark.slow
def test_a_blocked_ball_is_skipped_on_an_emulated_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with emulated_line(tmp_path) as line:
        assert line.run(tmp_path / "c", "--quick", "--experiment", "lift-off", "--experiment", "blocked-ball") == 0

    assert "the board is emulated: there is no ball to clamp" in capsys.readouterr().err
