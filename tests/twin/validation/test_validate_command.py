"""`board51 validate` as a user runs it: a report that needs nothing else, JSON, exit codes, one line for bad input."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import board51
from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from tests.harness.twin.independent_plant import Ball
from tests.harness.twin.judged_ball import BALL, captured, controller_of, model_of, steps
from twin.estimation.record import Record
from twin.readers.log import TwinLog

HEAD = f'[plant]\nname = "bench"\nmass_kg = {BALL.m}\ntravel_m = {BALL.travel}\nx_max_m = {BALL.x_max}\n'
RECORDING = '[[recording]]\nfile = "{file}"\nkind = "{kind}"\nuse = "judge"\n'


@pytest.fixture(scope="module")
def flight() -> Record:
    return BALL.closed_loop(steps(100), 3000, seed=200)


def write_log(path: Path, record: Record, ball: Ball, *, step: bool = True) -> None:
    """A log as a gateway leaves it: what the board announced, a capture, every sample."""
    law = controller_of(ball)
    point = law.operating_point
    parameters = pb.Parameters(
        session=1,
        sample_time_s=ball.tick,
        law=pb.LAW_LQI,
        gains=law.gains,
        i_0_a=point.i_c_a,
        x_0_m=point.x_m,
        u_0_v=point.u_c_v,
        u_max_v=5.0,
        stream_divider=1,
    )
    with TwinLog(path) as log:
        log.write(key("board51", "rig", "parameters"), parameters, message_type=pb.Parameters, log_time_ns=1)
        if step:
            capture = captured(ball, 5).captures[0]
            message = pb.CaptureRecord(
                sample_time_s=capture.sample_time_s,
                u_from_v=capture.u_from_v,
                u_to_v=capture.u_to_v,
                step_index=capture.step_index,
                i_c_a=capture.i_c_a.tolist(),
            )
            log.write(key("board51", "rig", "capture"), message, message_type=pb.CaptureRecord, log_time_ns=2)
        for n in range(len(record.t)):
            state = pb.State(
                sequence=n,
                tick=n,
                session=1,
                t_s=record.t[n],
                u_c_v=record.u_c[n],
                i_c_a=record.i_c[n],
                x_m=record.x[n],
                x_ref_m=record.x_ref[n],
                mode=pb.MODE_CLOSED_LOOP,
            )
            log.write(key("board51", "rig", "state"), state, message_type=pb.State, log_time_ns=n + 3)


def folder(path: Path, *, K_c: float = 1.0, kind: str = "closed-loop", file: str = "run.mcap") -> list[str]:
    """A campaign of one recording and a model beside it; the arguments that name them."""
    (path / "campaign.toml").write_text(HEAD + RECORDING.format(file=file, kind=kind))
    (path / "model.json").write_text(json.dumps(model_of(BALL, K_c=K_c).to_json()))
    return [str(path), "--model", str(path / "model.json"), "--out", str(path / "report")]


def run(*arguments: str) -> int:
    return board51.main(["validate", *arguments])


@pytest.mark.slow
def test_a_log_gives_a_report_that_needs_nothing_else(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log(tmp_path / "run.mcap", flight, BALL)

    assert run(*folder(tmp_path), "--figures", "pdf") == 0

    answer = capsys.readouterr().out.splitlines()[0]
    page = (tmp_path / "report" / "report.html").read_text()
    assert answer.startswith("The model explains these recordings")
    assert page.index(answer.split(":")[0]) < page.index("<img")  # the answer first
    assert 'alt="error over the horizon"' in page
    assert page.count("data:image/svg+xml;base64,") == 7  # 7, 8, horizon, residuals, 11 and 12, steps, bode
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "Not testable" not in page
    drawn = sorted((tmp_path / "report" / "figures").iterdir())
    assert [path.suffix for path in drawn] == [".pdf"] * 6
    assert all(path.read_bytes().startswith(b"%PDF") for path in drawn)
    numbers = json.loads((tmp_path / "report" / "validation.json").read_text())
    assert numbers["passed"] is True
    assert len(numbers["ahead"]) == 4
    assert numbers["frequency_responses"]["explains"] is True
    assert "The model explains the loop at " in page
    assert {row["name"] for row in numbers["closed_loop"]["steps"]} == {
        "rise_s",
        "settling_s",
        "overshoot",
        "iae_m_s",
        "effort_v2_s",
    }


@pytest.mark.slow
def test_json_on_stdout_and_exit_1_for_a_wrong_model(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log(tmp_path / "run.mcap", flight, BALL)

    assert run(*folder(tmp_path, K_c=0.8), "--json") == 1

    numbers = json.loads(capsys.readouterr().out)
    assert numbers["passed"] is False
    assert numbers["failures"]


def test_a_csv_without_controller_still_gives_a_report(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.column_stack([flight.t, flight.u_c, flight.i_c, flight.x])
    lines = ["t,u_c,i_c,x", *(",".join(f"{value:.9g}" for value in row) for row in table)]
    (tmp_path / "run.csv").write_text("\n".join(lines))

    assert run(*folder(tmp_path, file="run.csv"), "--json") == 0

    numbers = json.loads(capsys.readouterr().out)
    assert "[controller]" in numbers["closed_loop"]["not_testable"]
    assert numbers["amplifier"]["from_steps"] is False
    assert "Not testable" in (tmp_path / "report" / "report.html").read_text()


def test_only_an_amplifier_step_tests_only_the_amplifier(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = replace(flight, **{name: getattr(flight, name)[:0] for name in ("t", "u_c", "i_c", "x", "x_ref")})
    write_log(tmp_path / "run.mcap", empty, BALL)

    assert run(*folder(tmp_path, kind="amplifier-step"), "--json") == 1

    numbers = json.loads(capsys.readouterr().out)
    assert numbers["passed"] is None
    assert numbers["amplifier"]["rmse_a"] == pytest.approx(BALL.sigma_i, rel=0.09)


@pytest.mark.parametrize("wrong", ["no model", "no campaign", "no recording", "other rig", "out is a file"])
def test_bad_input_is_one_line_and_exit_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flight: Record, wrong: str
) -> None:
    arguments = folder(tmp_path)
    if wrong != "no recording":
        write_log(tmp_path / "run.mcap", replace(flight, t=flight.t[:0]), BALL)
    if wrong == "no model":
        (tmp_path / "model.json").write_text("{")
    elif wrong == "no campaign":
        (tmp_path / "campaign.toml").unlink()
    elif wrong == "other rig":
        model = model_of(replace(BALL, m=2.0 * BALL.m)).to_json()
        (tmp_path / "model.json").write_text(json.dumps(model))
    elif wrong == "out is a file":
        (tmp_path / "report").write_text("")

    assert run(*arguments) == 2

    error = capsys.readouterr().err
    assert error.startswith("board51 validate: ")
    assert error.count("\n") == 1


WRONG: dict[str, Callable[[Record], Record]] = {
    "millimetres": lambda r: replace(r, x=r.x * 1e3, x_ref=r.x_ref * 1e3),
    "swapped": lambda r: replace(r, i_c=r.u_c, u_c=r.i_c),
}


@pytest.mark.parametrize("problem", WRONG)
def test_a_wrong_channel_is_not_blamed_on_the_model(
    problem: str, tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log(tmp_path / "run.mcap", WRONG[problem](flight), BALL, step=False)

    code = run(*folder(tmp_path))

    error = capsys.readouterr().err
    assert code == 2
    assert problem in error
    assert error.count("\n") == 1


def test_constant_channels_test_nothing_and_are_said(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    n = len(flight.t)
    constant = replace(flight, u_c=np.full(n, 2.0), i_c=np.full(n, 0.6), x=np.full(n, 3e-3))
    write_log(tmp_path / "run.mcap", constant, BALL, step=False)

    code = run(*folder(tmp_path))

    output = capsys.readouterr()
    assert code == 1
    assert "could not be tested" in output.out
    assert output.err.count("throughout") == 3


@pytest.mark.slow
def test_a_rig_whose_law_is_unknown_is_shown_alone(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.column_stack((flight.t, flight.u_c, flight.i_c, flight.x, flight.x_ref))
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t,u_c,i_c,x,x_ref", comments="")

    code = run(*folder(tmp_path, file="run.csv"))

    assert code == 0
    assert "closed loop could not be compared" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "report" / "validation.json").read_text())
    figures = {row["name"]: row for row in numbers["closed_loop"]["rig_alone"]}
    assert figures["settling_s"]["count"] > 5
    assert 0.1 < figures["settling_s"]["rig"] < 0.4  # of a loop whose slowest mode has 50 to 60 ms
    assert "measured closed loop of run.csv" in (tmp_path / "report" / "report.html").read_text()
