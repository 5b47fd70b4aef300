"""`board51 identify` as a user runs it: files in, model.json out, exit codes, one line for bad input."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import board51
from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from tests.harness.twin.independent_plant import Ball, wandering
from twin.estimation.record import Record
from twin.model.parameters import Model
from twin.readers.log import TwinLog

BALL = Ball()
HEAD = f'[plant]\nname = "bench"\nmass_kg = {BALL.m}\ntravel_m = {BALL.travel}\nx_max_m = {BALL.x_max}\n'
NAMES = ("t", "u_c", "i_c", "x", "x_ref")


@pytest.fixture(scope="module")
def flight() -> Record:
    return BALL.closed_loop(wandering(1, 2500), 2500, seed=2)


def table(record: Record) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.column_stack([getattr(record, name) for name in NAMES])


def write_csv(path: Path, record: Record, names: tuple[str, ...] = NAMES, **scale: float) -> None:
    values = table(record) * np.array([scale.get(name, 1.0) for name in NAMES])
    lines = [",".join(names), *(",".join(f"{v:.9g}" for v in row) for row in values)]
    data = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)


def write_log(path: Path, record: Record) -> None:
    with TwinLog(path) as log:
        for n, (t, u, i, x, x_ref) in enumerate(table(record)):
            state = pb.State(
                sequence=n, tick=n, session=1, t_s=t, u_c_v=u, i_c_a=i, x_m=x, x_ref_m=x_ref, mode=pb.MODE_CLOSED_LOOP
            )
            log.write(key("board51", "rig", "state"), state, message_type=pb.State, log_time_ns=n + 1)


def campaign(folder: Path, file: str, more: str = "") -> Path:
    path = folder / "campaign.toml"
    path.write_text(f'{HEAD}[[recording]]\nfile = "{file}"\nkind = "closed-loop"\nuse = "fit"\n{more}')
    return path


def run(*arguments: str | Path) -> int:
    return board51.main(["identify", *map(str, arguments)])


def test_csv_matlab_and_log_give_the_same_model(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_csv(tmp_path / "a.csv.gz", flight)
    savemat(tmp_path / "b.mat", {name: getattr(flight, name) for name in NAMES})
    write_log(tmp_path / "c.mcap", flight)
    models = []
    for file in ("a.csv.gz", "b.mat", "c.mcap"):
        out = tmp_path / f"{file}.json"

        assert run(campaign(tmp_path, file), "--out", out, "--quiet") == 0

        models.append(Model.load(out))
    capsys.readouterr()
    for name in ("K_A", "T_A", "K_c", "b"):
        values = [model.parameters[name].value for model in models]
        spread = models[0].parameters[name].std
        assert spread is not None
        assert np.ptp(values) < 0.02 * spread  # nine digits in the CSV
        assert abs(values[0] - getattr(BALL, name)) < 4.0 * spread


def test_columns_scales_and_skip_are_applied(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_csv(tmp_path / "a.csv", flight, ("time", "volts", "mA", "mm", "ref"), i_c=1e3, x=1e3, x_ref=1e3)
    columns = (
        'skip_s = 0.5\ncolumns = { t = "time", u_c = "volts", i_c = { column = "mA", scale = 1e-3 }, '
        'x = { column = "mm", scale = 1e-3 }, x_ref = { column = "ref", scale = 1e-3 } }\n'
    )

    assert run(campaign(tmp_path, "a.csv", columns), "--json", "--quiet") == 0

    model = json.loads(capsys.readouterr().out)
    assert set(model) == {"plant", "parameters", "causes", "noise", "provenance"}
    assert model["causes"] == []
    K_c = model["parameters"]["K_c"]
    assert K_c["ci95"][0] < BALL.K_c < K_c["ci95"][1]
    assert K_c["unit"] == "N m^2/A^2"
    assert K_c["verdict"] == "identified"
    assert model["provenance"]["recordings"][0]["samples"] == 2250


def test_a_table_for_people_and_progress_on_stderr(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_csv(tmp_path / "a.csv", flight)

    assert run(campaign(tmp_path, "a.csv")) == 0

    output = capsys.readouterr()
    assert "95 % interval" in output.out
    assert "identified" in output.out
    assert "start values" in output.err


def test_what_cannot_be_known_is_exit_code_1_and_a_model_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    levels = (0.0, 0.8, 1.6)
    record = BALL.driven(lambda k: levels[k // 100 % 3], 600, seed=3, kind="amplifier-step", name="steps")
    write_csv(tmp_path / "a.csv", record)
    path = tmp_path / "campaign.toml"
    path.write_text(f'{HEAD}[[recording]]\nfile = "a.csv"\nkind = "amplifier-step"\nuse = "fit"\n')

    assert run(path, "--out", tmp_path / "m.json") == 1

    assert Model.load(tmp_path / "m.json").parameters["K_c"].verdict == "not-identifiable"
    assert "no usable model" in capsys.readouterr().err


BAD: dict[str, tuple[str | bytes, str]] = {
    "absent": ("", "is not at"),
    "no rows": ("t,u_c,i_c,x\n", "holds no rows"),
    "no column": ("t,u,i_c,x\n0,1,2,3\n1,1,2,3\n", "has no column 'u_c'"),
    "twice": ("t,t,i_c,x\n0,1,2,3\n", "twice"),
    "no names": ("0,1,2,3\n1,1,2,3\n", "line 1 holds numbers where the names"),
    "clock times": ("t,u_c,i_c,x\n12:00:01,1,2,3\n12:00:02,1,2,3\n", "no cell of column 't', mapped to t, is a number"),
    "cut off": ("t,u_c,i_c,x\n0,1,2\n", "not a table"),
    "not text": (b"\xff\xfe\x00\x01" * 20, "not text"),
    "broken gzip": (b"\x1f\x8b\x08\x00rubbish", "damaged"),
    "not a log": (b"\x89MCAP0\r\n" + b"x" * 100, "is damaged at byte 8 of 108: not a record"),
    "not MATLAB": (b"MATLAB 5.0 MAT-file but not quite", "MATLAB"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_recording_is_one_line_and_exit_code_2(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("BOARD51_DATA", raising=False)
    content, problem = BAD[name]
    if name != "absent":
        (tmp_path / "a.csv").write_bytes(content.encode() if isinstance(content, str) else content)

    code = run(campaign(tmp_path, "a.csv"), "--quiet")

    error = capsys.readouterr().err
    assert code == 2
    assert problem in error
    assert error.count("\n") == 1


def test_text_in_cells_is_counted_and_left_out(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_csv(tmp_path / "a.csv", flight)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    cells = lines[1000].split(",")
    lines[1000] = ",".join([*cells[:3], "overflow", cells[4]])
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")

    assert run(campaign(tmp_path, "a.csv"), "--quiet") == 0

    assert "1 cells of x are not numbers" in capsys.readouterr().out


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        run("--help")

    assert stopped.value.code == 0
    assert "board51 identify" in capsys.readouterr().out


def test_a_log_brings_captures_scalings_and_sessions(tmp_path: Path, flight: Record) -> None:
    rng = np.random.default_rng(4)
    after = BALL.K_A * 2.0 * (1.0 - np.exp(-40e-6 * np.arange(800) / BALL.T_A))
    current = np.concatenate((np.zeros(100), after)) + BALL.sigma_i * rng.normal(size=900)
    capture = pb.CaptureRecord(
        session=1, sample_time_s=40e-6, u_from_v=0.0, u_to_v=2.0, step_index=100, i_c_a=current.tolist()
    )
    parameters = pb.Parameters(session=1, sample_time_s=2e-3, i_lsb_a=5e-4, x_lsb_m=1e-6)
    with TwinLog(tmp_path / "a.mcap") as log:
        log.write(key("board51", "rig", "parameters"), parameters, message_type=pb.Parameters, log_time_ns=1)
        log.write(key("board51", "rig", "capture"), capture, message_type=pb.CaptureRecord, log_time_ns=2)
        for n, (t, u, i, x, x_ref) in enumerate(table(flight)):
            session = 1 if n < 1000 else 2  # the board was reset: its clock starts anew
            state = pb.State(session=session, t_s=t if n < 1000 else t - 2.0, u_c_v=u, i_c_a=i, x_m=x, x_ref_m=x_ref)
            log.write(key("board51", "rig", "state"), state, message_type=pb.State, log_time_ns=n + 3)

    assert run(campaign(tmp_path, "a.mcap"), "--out", tmp_path / "m.json", "--quiet") == 0

    model = Model.load(tmp_path / "m.json")
    (usage,) = model.provenance["recordings"]
    assert usage["captures"] == 1
    assert usage["pieces"] >= 2
    T_A = model.parameters["T_A"]
    assert T_A.std is not None
    assert abs(T_A.value - BALL.T_A) < 4.0 * T_A.std
    assert T_A.std < 0.01 * BALL.T_A  # 800 samples at 25 kHz know it better than 5 s at 500 Hz
    assert model.provenance["amplifier_shape"]["first_order"]


def test_a_log_of_two_boards_asks_which_one(tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]) -> None:
    with TwinLog(tmp_path / "a.mcap") as log:
        for n, (t, u, i, x, _) in enumerate(table(flight)):
            for board in ("left", "right"):
                state = pb.State(session=1, t_s=t, u_c_v=u, i_c_a=i, x_m=x if board == "left" else 0.0)
                log.write(key("board51", board, "state"), state, message_type=pb.State, log_time_ns=n + 1)

    assert run(campaign(tmp_path, "a.mcap"), "--quiet") == 2
    assert "holds 2 boards: left, right" in capsys.readouterr().err

    assert run(campaign(tmp_path, "a.mcap", 'board = "left"\n'), "--quiet") == 0


def test_a_result_that_cannot_be_written_is_said_before_the_work(
    tmp_path: Path, flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    write_csv(tmp_path / "a.csv", flight)

    assert run(campaign(tmp_path, "a.csv"), "--out", tmp_path / "absent" / "m.json") == 2

    error = capsys.readouterr().err
    assert "cannot be written" in error
    assert error.count("\n") == 1
