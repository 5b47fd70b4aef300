"""`board51 campaign run` when line, board or ball misbehave: said, repeated where that helps, always left parked."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest

import board51
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.campaign_line import PLANT, emulated_line, standings, start, summary
from tests.harness.gateway.gateway_peers import client, gateway_config, running, wait_for
from tests.patience import HANG_S

LIFT_OFF = ("--quick", "--experiment", "lift-off", "--json")


@pytest.mark.slow
def test_a_recording_with_lost_samples_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    with emulated_line(tmp_path) as line:
        process = line.start(folder, *LIFT_OFF)
        wait_for(lambda: (line.bus.states()[-1].u_c_v or 0.0) > 1.0, "ramp")
        line.emulator.inject("lost=0.5@0+0.5:tx")
        out, err = process.communicate(timeout=HANG_S)
        line.assert_parked()

    table = json.loads(out)
    assert process.returncode == 0, err
    (row,) = table["experiments"]
    assert row["standing"] == "recorded"
    assert row["attempts"] >= 2
    assert "samples are missing" in row["said"][0]
    assert "not usable" in err
    assert (folder / "lift-off.mcap").is_file()


@pytest.mark.slow
def test_a_line_that_loses_all_the_time_is_given_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with emulated_line(tmp_path, faults=("lost=0.02:tx",)) as line:  # one STATE in four
        code = line.run(tmp_path / "c", *LIFT_OFF)
        line.assert_parked()

    table = summary(capsys)
    assert code == 1
    assert standings(table) == {"lift-off": "given-up"}
    assert table["experiments"][0]["attempts"] == 3
    assert not table["complete"]
    assert not list((tmp_path / "c").glob("*.mcap"))


@pytest.mark.slow
def test_a_heavier_start_is_met_with_more_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # 0.05 N of dry friction on a weight of 0.081 N: lift-off at 3.30 V * sqrt(1.62) = 4.2 V; the first ramp: 3.6 V.
    with emulated_line(tmp_path, effects={"coulomb-friction": 0.05}) as line:
        code = line.run(tmp_path / "c", *LIFT_OFF)

    table = summary(capsys)
    assert code == 0
    assert table["experiments"][0]["attempts"] >= 2
    assert "never left its rest" in table["experiments"][0]["said"][0]
    assert table["lift_off_v"] == pytest.approx(4.2, rel=0.08)


@pytest.mark.slow
def test_a_stuck_ball_ends_what_depends_on_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stuck = {"coulomb-friction": 0.05, "constant-force": -0.04}
    with emulated_line(tmp_path, effects=stuck) as line:
        code = line.run(
            tmp_path / "c", "--quick", "--experiment", "lift-off", "--experiment", "rest", "--u-max", "4", "--json"
        )
        highest = max(state.u_c_v for state in line.bus.states())
        line.assert_parked()

    table = summary(capsys)
    assert code == 1
    assert standings(table) == {"lift-off": "given-up", "rest": "given-up"}
    assert "that is the limit: raise --u-max, or look whether the ball is stuck" in table["experiments"][0]["said"][-1]
    assert highest <= 4.0


@pytest.mark.slow
def test_a_reset_in_flight_costs_one_attempt(tmp_path: Path) -> None:
    with emulated_line(tmp_path) as line:
        process = line.start(tmp_path / "c", "--quick", "--experiment", "steps", "--json")
        wait_for(lambda: line.bus.states()[-1].x_ref_m > 3.1e-3, "step")
        line.emulator.inject("watchdog")
        out, err = process.communicate(timeout=HANG_S)
        line.assert_parked()

    (row,) = json.loads(out)["experiments"]
    assert process.returncode == 0, err
    assert row["standing"] == "recorded"
    assert row["attempts"] >= 2
    assert "new session" in row["said"][0]


@pytest.mark.slow
def test_somebody_elses_command_spoils_a_recording(tmp_path: Path) -> None:
    with emulated_line(tmp_path) as line:
        process = line.start(tmp_path / "c", "--quick", "--experiment", "steps", "--json")
        wait_for(lambda: line.bus.states()[-1].x_ref_m > 3.1e-3, "step")
        line.bus.command("mine", set_reference=pb.SetReference(x_ref_m=3.2e-3))
        out, err = process.communicate(timeout=HANG_S)

    (row,) = json.loads(out)["experiments"]
    assert process.returncode == 0, err
    assert row["attempts"] >= 2
    assert "test sent set_reference to the board in between" in row["said"][0]


@pytest.mark.slow
def test_somebody_elses_stop_ends_the_campaign(tmp_path: Path) -> None:
    with emulated_line(tmp_path) as line:
        process = line.start(tmp_path / "c", "--quick", "--experiment", "steps")
        wait_for(lambda: line.bus.states()[-1].mode == pb.MODE_CLOSED_LOOP, "flight")
        line.bus.command("emergency", stop=pb.Stop())
        _, err = process.communicate(timeout=HANG_S)
        later = line.bus.await_states(50)
        line.assert_parked()

    assert process.returncode == 1
    assert "test stopped the board" in err
    assert all(state.mode == pb.MODE_IDLE for state in later)


def test_a_stop_since_its_order_ends_a_campaign_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The STOP comes while the process of the campaign starts, and hears nothing yet."""
    with emulated_line(tmp_path) as line:
        ordered_ns = time.time_ns()
        line.bus.command("emergency", stop=pb.Stop())
        code = line.run(tmp_path / "c", *LIFT_OFF, "--issued", str(ordered_ns))
        states = line.bus.states()

    assert code == 1
    assert "somebody stopped the board" in capsys.readouterr().err
    assert not any(state.u_c_v for state in states)


@pytest.mark.slow
def test_without_its_gateway_a_campaign_ends_and_says_that_the_coil_may_be_on(tmp_path: Path) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text(PLANT)
    words = ("--quick", "--experiment", "steps", "--plant", str(plant))
    with Emulator(tcp=False, speed=3.0) as emulator:
        config = gateway_config(emulator.urls[0], host_loss_timeout_s=3.0)
        with running(config), client(config.zenoh.listen[0]) as bus:
            wait_for(bus.states, "first sample")
            process = start(config.zenoh.listen[0], tmp_path / "c", *words)
            wait_for(lambda: bus.states()[-1].mode == pb.MODE_CLOSED_LOOP, "flight")
        _, err = process.communicate(timeout=HANG_S)
        assert process.returncode == 1
        assert "gateway, link or board has failed" in err
        assert "THE COIL MAY BE ON" in err
        assert "Traceback" not in err

        with running(config), client(config.zenoh.listen[0]) as bus:
            wait_for(bus.states, "first sample")
            # The board's own host-loss policy has switched the coil off meanwhile.
            wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")
            resumed = start(config.zenoh.listen[0], tmp_path / "c", *words)
            _, err = resumed.communicate(timeout=HANG_S)
    assert resumed.returncode == 0, err


@pytest.mark.slow
def test_sigterm_ends_like_ctrl_c(tmp_path: Path) -> None:
    with emulated_line(tmp_path) as line:
        process = line.start(tmp_path / "c", "--quick", "--experiment", "lift-off")
        wait_for(lambda: (line.bus.states()[-1].u_c_v or 0.0) > 1.0, "ramp")
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=HANG_S)
        line.assert_parked()

    assert process.returncode == 1
    assert "interrupted: ball parked, coil off; 0 of 1 recordings" in err


@pytest.mark.slow
def test_a_board_that_is_not_there_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with emulated_line(tmp_path) as line:
        words = ["campaign", "run", str(tmp_path / "c"), "--board", "other", "--connect", line.endpoint]
        assert board51.main(words) == 1

    assert "No samples from board51/other" in capsys.readouterr().err


def test_ctrl_c_before_the_first_sample_says_that_nothing_was_sent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(signal.SIGINT)

    def interrupt() -> None:
        wait_for(lambda: signal.getsignal(signal.SIGINT) is not before, "the campaign's own handler")
        os.kill(os.getpid(), signal.SIGINT)

    with emulated_line(tmp_path) as line:
        interrupter = threading.Thread(target=interrupt)
        interrupter.start()
        words = ["campaign", "run", str(tmp_path / "c"), "--board", "other", "--connect", line.endpoint]
        code = board51.main(words)
        interrupter.join()

    err = capsys.readouterr().err
    assert code == 1
    assert "interrupted before the board's first sample: nothing was sent to it" in err
    assert "fault of board51" not in err
