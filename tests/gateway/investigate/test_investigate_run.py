"""`board51 investigate` on an emulated rig behind a real gateway.  What is hidden, the emulator alone knows."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import board51
from gateway.investigate.work import Work
from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from protocol.errors import ServiceError
from tests.harness.gateway.campaign_line import ROOT, Line, emulated_line
from tests.harness.gateway.gateway_peers import wait_for
from tests.patience import HANG_S


def words(line: Line, folder: Path, *more: str) -> list[str]:
    rig = ("--connect", line.endpoint, "--plant", str(line.plant))
    return ["investigate", "rig", "--out", str(folder), *rig, "--quick", "--json", *more]


def begun(line: Line, folder: Path) -> subprocess.Popen[str]:
    """Start an investigation in a process of its own, which ends with the line at the latest."""
    process = subprocess.Popen(
        [sys.executable, "-m", "board51", *words(line, folder)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    line.started.append(process)
    return process


def steps_of(table: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [step[kind] for step in table["steps"] if kind in step]


def recorded(table: dict[str, Any]) -> list[str]:
    return [
        name for step in steps_of(table, "performed") for name, how in step["standings"].items() if how == "recorded"
    ]


@pytest.mark.slow
def test_an_interrupted_investigation_parks_the_ball_goes_on_and_ends_with_the_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "i"
    # At the speed of a real board: the diagnoses take longer than the flights, and beside them each sample costs.
    with emulated_line(tmp_path, speed=1.0, effects={"quadratic-drag": 2.0}) as line:
        process = begun(line, folder)
        wait_for(lambda: line.bus.states()[-1].mode == pb.MODE_CLOSED_LOOP, "flight")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=HANG_S)
        line.assert_parked()

        code = board51.main(words(line, folder))
        line.assert_parked()

    stopped = json.loads(out)
    assert process.returncode == 1, err
    assert stopped["ended"] is None
    assert steps_of(stopped, "performed")[0]["standings"]["wide-steps"] == "interrupted"
    assert "ball parked, coil off" in err
    assert f"To continue: board51 investigate rig --out {folder}" in err
    assert "Traceback" not in err

    captured = capsys.readouterr()
    table = json.loads(captured.out)
    assert code == 0, captured.err
    assert table["ended"]["stands"]
    assert [cause["name"] for cause in table["answer"]["causes"]] == ["quadratic-drag"]
    made = recorded(table)
    assert len(made) == len(set(made)), "nothing is recorded twice"
    assert {r.file for r in load(folder).recordings} == {f"{name}.mcap" for name in made}
    assert all(step[kind]["why"] for step in table["steps"] for kind in step)
    assert 0.0 < table["rig_s"] < 60.0
    assert (folder / "diagnosis" / "report.html").is_file()
    assert json.loads((folder / "investigation.json").read_text())["ended"] == table["ended"]


@pytest.mark.slow
def test_a_stop_during_a_diagnosis_ends_the_investigation(tmp_path: Path) -> None:
    with emulated_line(tmp_path) as line:
        rig = ("--board", "rig", "--connect", line.endpoint, "--plant", str(line.plant), "--quick")
        work = Work(tmp_path / "i", rig, ordered_ns=time.time_ns(), workers=1, write_line=print)
        line.bus.command("emergency", stop=pb.Stop())
        with pytest.raises(ServiceError, match="somebody stopped the board"):
            work.perform(["lift-off"])
        states = line.bus.states()

    assert not any(state.u_c_v for state in states)


@pytest.mark.slow
def test_a_killed_investigation_leaves_the_ball_parked(tmp_path: Path) -> None:
    with emulated_line(tmp_path) as line:
        process = begun(line, tmp_path / "i")
        wait_for(lambda: line.bus.states()[-1].mode == pb.MODE_CLOSED_LOOP, "flight")
        process.kill()
        line.assert_parked()


@pytest.mark.sample
def test_a_class_that_the_logged_flight_cannot_tell_apart_is_split(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "logged"
    with emulated_line(tmp_path, effects={"air-gap-offset": 2.5e-4}) as line:
        assert line.run(folder, "--quick", "--experiment", "steps") == 0
        capsys.readouterr()
        code = board51.main(words(line, folder))
        line.assert_parked()

    captured = capsys.readouterr()
    assert code == 0, captured.err
    table = json.loads(captured.out)
    first = steps_of(table, "diagnosed")[0]
    assert first["recordings"] == ["steps"], "what is logged is looked at first"
    (class_,) = first["found"]["causes"]
    assert {class_["name"], *class_["indistinguishable_from"]} >= {"air-gap-offset", "force-exponent"}
    splitting = steps_of(table, "performed")[0]
    assert "force-exponent" in splitting["why"]
    assert "standard errors apart" in splitting["why"]
    (answer,) = table["answer"]["causes"]
    assert answer["name"] == "air-gap-offset"
    # No flight tells a gap from an x_max that the campaign states wrongly: that is left to a calliper.
    assert answer["indistinguishable_from"] == ["stated-x-max"]
    # What the judges show may ask for a further recording: they need not be the last.
    assert {"wide-steps-judge", "multisine-judge"} <= set(recorded(table))


def test_a_budget_that_pays_for_nothing_moves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = board51.main(["investigate", "rig", "--out", str(tmp_path / "i"), "--budget", "5"])

    captured = capsys.readouterr()
    assert code == 1
    assert "the budget is spent" in captured.err
    assert "no diagnosis yet" in captured.out


def test_a_dry_run_says_what_would_be_first_and_touches_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = board51.main(["investigate", "rig", "--out", str(tmp_path / "i"), "--dry-run"])

    out = capsys.readouterr().out
    assert code == 0
    assert "next: record lift-off, rest, amplifier-steps, wide-steps" in out
    assert "warm-run" in out
    assert not (tmp_path / "i").exists()


def test_a_gateway_that_is_not_there_is_one_line_and_nothing_is_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = board51.main(["investigate", "rig", "--out", str(tmp_path / "i"), "--connect", "tcp/127.0.0.1:9"])

    err = capsys.readouterr().err.strip().splitlines()
    assert code == 1
    assert "board51 investigate: campaign run ended with exit code 1" in err[-1]
    assert "the same command continues" in err[-1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "investigation.json, line 1: not JSON"),
        ('{"format": 7, "board": "rig", "steps": []}', "investigation.json: format = 7 is not 1"),
        ('{"format": 1, "board": "rig"}', "investigation.json: steps is missing"),
        (
            '{"format": 1, "board": "rig", "steps": [{"diagnosed": {"why": ""}}]}',
            "steps 1.diagnosed.thorough is",
        ),
        ('{"format": 1, "board": "rig", "steps": ["x"]}', "steps 1 = 'x' is not a table"),
        ('{"format": 1, "board": "rig", "steps": [{}]}', "steps 1 is not one of performed | diagnosed"),
        ('{"format": 1, "board": "other", "steps": []}', "is an investigation of other, not of rig"),
    ],
)
def test_a_folder_that_is_damaged_or_another_s_is_refused(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "investigation.json").write_text(text)

    code = board51.main(["investigate", "rig", "--out", str(tmp_path), "--dry-run"])

    err = capsys.readouterr().err
    assert code == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("more", "message"),
    [(("--budget", "nan"), "--budget nan"), (("--budget", "0"), "--budget 0"), (("--site", "a/b"), "--site")],
)
def test_options_that_make_no_sense_are_refused(
    more: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert board51.main(["investigate", "rig", "--out", str(tmp_path / "i"), *more]) == 2
    assert message in capsys.readouterr().err
