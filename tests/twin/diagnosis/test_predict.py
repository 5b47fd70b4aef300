"""`board51 predict`: predictions of the reading, N samples ahead, that anybody can check."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import board51
from gateway.emulator.firmware_model.flash import POSITION
from gateway.emulator.plant.constants import CE152
from gateway.emulator.plant.effects import EFFECTS
from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from protocol.wire.messages import Shape
from tests.harness.twin.emulated_campaign import TICK_S, Lab
from tests.harness.twin.true_model import true_model
from twin.estimation.record import Record
from twin.identification.horizon import error_at
from twin.inference.theta import Theta
from twin.prediction import predict
from twin.readers.log import TwinLog

NAMES = ("t", "u_c", "i_c", "x", "x_ref")
AHEAD = 10
# Every way in which a cause enters: drive, current, field, force, reading, sensor's state, delays, warmth, phase.
CAUSES = ("motional-emf", "actuation-delay", "coulomb-friction", "position-sensor-lag")
MORE_CAUSES = (
    "amplifier-gain-drift",
    "amplifier-dead-zone",
    "air-gap-offset",
    "core-saturation",
    "eddy-current-lag",
    "periodic-disturbance",
    "position-sensor-gain",
    "sampling-delay",
)


def fly(effects: dict[str, float], *, ticks: int = 2000) -> Record:
    lab = Lab(CE152, effects=effects, seed=4)
    lab.fly()
    lab.run(300)
    span, middle = POSITION.span(0.7e-3), POSITION.to_count(2.85e-3)
    lab.excite(Shape.MULTISINE, on_reference=True, amplitude=span, offset=middle, period=1000, seed=5)
    return lab.record("flight", "closed-loop", ticks)


@cache
def floor_m() -> float:
    """The error ahead of the right model of a rig without effects."""
    error_m = predict(true_model(), fly({}), AHEAD).rmse_m
    assert error_m is not None
    return error_m


@pytest.fixture(scope="module")
def gap_flight() -> Record:
    return fly({"air-gap-offset": 8e-4})


def files(folder: Path, record: Record) -> list[Path]:
    """The same flight as CSV, MATLAB and MCAP."""
    table = np.column_stack([getattr(record, name) for name in NAMES])
    np.savetxt(folder / "a.csv", table, delimiter=",", header=",".join(NAMES), comments="", fmt="%.12g")
    savemat(folder / "b.mat", {name: getattr(record, name) for name in NAMES})
    with TwinLog(folder / "c.mcap") as log:
        for n, (t, u, i, x, x_ref) in enumerate(table):
            state = pb.State(
                sequence=n, tick=n, session=1, t_s=t, u_c_v=u, i_c_a=i, x_m=x, x_ref_m=x_ref, mode=pb.MODE_CLOSED_LOOP
            )
            log.write(key("board51", "rig", "state"), state, message_type=pb.State, log_time_ns=n + 1)
    return [folder / "a.csv", folder / "b.mat", folder / "c.mcap"]


def model_file(folder: Path, effects: dict[str, float] | None = None) -> Path:
    path = folder / f"model_{len(list(folder.iterdir()))}.json"
    path.write_text(json.dumps(true_model(effects=effects).to_json()))
    return path


def run(*arguments: str | Path) -> int:
    return board51.main(["predict", *map(str, arguments)])


@pytest.mark.parametrize("name", [*CAUSES, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE_CAUSES)])
def test_the_true_cause_brings_the_prediction_down_to_the_noise(name: str) -> None:
    """The floor is that of a rig without effects under its own model: 9 um, what the filter's estimate leaves.

    The emulated rig, its integration and its form of each cause are not the twin's.  3000 overlapping predictions of
    20 ms are 150 independent ones: their rms has a standard error of 6 %, and a periodic force leaves a 48th of a turn.
    """
    effects = {name: EFFECTS[name].medium}
    record = fly(effects)

    plain = predict(true_model(), record, AHEAD).rmse_m
    extended = predict(true_model(effects=effects), record, AHEAD).rmse_m

    assert plain is not None
    assert extended is not None
    assert extended < 1.25 * floor_m()
    assert plain > 1.35 * floor_m()


def test_without_causes_it_agrees_with_the_filter_of_the_identification() -> None:
    """Another integration of the same (1) and (6): they differ by micrometres' tenths, not in sum."""
    record, model = fly({}), true_model()
    n = model.noise
    theta = Theta(
        K_A=model.K_A,
        T_A=model.T_A,
        K_c=model.K_c,
        b=model.b,
        sigma_i_c_a=n.sigma_i_c_a,
        sigma_x_m=n.sigma_x_m,
        process_i_c_a=n.process_i_c_a,
        process_a_m_s2=n.process_a_m_s2,
        closed_form=True,
    )
    other = error_at(AHEAD * TICK_S, [record], model.plant, theta, TICK_S)

    prediction = predict(model, record, AHEAD)

    assert other is not None
    assert prediction.rmse_m == pytest.approx(other.rmse_m, rel=0.01)
    assert abs(len(prediction.x) - other.count) <= 2


def test_a_prediction_knows_nothing_of_what_comes_later(gap_flight: Record) -> None:
    """Readings after k - N may be anything: x_hat(k) is the same bit by bit; u_c in between it does know."""
    model = true_model(effects={"air-gap-offset": 8e-4, "position-sensor-lag": 5e-4})
    k = 1000
    noise = np.random.default_rng(1).normal(size=len(gap_flight.t))
    later = np.arange(len(gap_flight.t)) > k - AHEAD
    other = replace(gap_flight, x=gap_flight.x + 5e-6 * later * noise, i_c=gap_flight.i_c + 5e-3 * later * noise)
    kicked = replace(gap_flight, u_c=gap_flight.u_c + 0.05 * (np.arange(len(later)) == k - 1))

    def x_hat(record: Record) -> float:
        prediction = predict(model, record, AHEAD)
        return float(prediction.x_hat[prediction.t == record.t[k]][0])

    assert x_hat(other) == x_hat(gap_flight)
    assert x_hat(kicked) > x_hat(gap_flight)


def test_no_prediction_throws_the_ball_through_a_stop(gap_flight: Record) -> None:
    """A model with the coil at the stop has the ball ten travels away 40 ms on; a rig has stops."""
    model = true_model()
    wrong = replace(model, plant=replace(model.plant, x_max_m=model.plant.travel_m * 1.02))

    right = true_model(effects={"air-gap-offset": 8e-4})
    thrown, bounded = predict(wrong, gap_flight, 20).x_hat, predict(right, gap_flight, AHEAD).x_hat

    travel_m = model.plant.travel_m
    assert thrown.min() >= -0.25 * travel_m
    assert thrown.max() <= 1.25 * travel_m
    assert np.isclose(thrown, 1.25 * travel_m).any()
    assert bounded.min() > 0.0
    assert bounded.max() < travel_m


def test_the_phase_of_a_periodic_force_is_taken_from_the_past_alone() -> None:
    record = fly({"periodic-disturbance": 2e-3}, ticks=900)
    model = true_model(effects={"periodic-disturbance": 2e-3})
    k = 600
    cut = replace(record, **{name: getattr(record, name)[: k + 1] for name in NAMES})

    whole, until = predict(model, record, AHEAD), predict(model, cut, AHEAD)

    # the last samples of a record are told from a contact by what follows them: compare those before
    common = whole.t <= until.t[-1]
    assert np.array_equal(whole.x_hat[common], until.x_hat)


@pytest.mark.parametrize("file", [0, 1, 2])
def test_the_printed_error_is_that_of_the_rows(
    tmp_path: Path, gap_flight: Record, capsys: pytest.CaptureFixture[str], file: int
) -> None:
    recording = files(tmp_path, gap_flight)[file]
    model = model_file(tmp_path, {"air-gap-offset": 8e-4})

    assert run(model, recording, "--horizon", "7", "--out", tmp_path / "p.csv", "--json") == 0

    summary = json.loads(capsys.readouterr().out)
    lines = (tmp_path / "p.csv").read_text().splitlines()
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    assert lines[0] == "t,x,x_hat"
    assert summary["count"] == len(rows)
    assert summary["horizon_samples"] == 7
    assert summary["rmse_m"] == pytest.approx(math.sqrt(sum((x - p) ** 2 for _, x, p in rows) / len(rows)), rel=1e-6)
    assert summary["count"] + sum(summary["left_out"].values()) == summary["samples"]
    measured = dict(zip(np.round(gap_flight.t, 6), gap_flight.x, strict=True))
    assert all(abs(measured[round(t, 6)] - x) < 1e-12 for t, x, _ in rows)
    assert summary["rmse_m"] < 1.2e-5


def test_a_recording_of_a_campaign_comes_with_its_columns(
    tmp_path: Path, gap_flight: Record, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.column_stack([gap_flight.t, gap_flight.u_c, gap_flight.i_c, 1e3 * (5.7e-3 - gap_flight.x)])
    np.savetxt(tmp_path / "f.csv", table, delimiter=",", header="t,u,i,gap_mm", comments="", fmt="%.12g")
    (tmp_path / "campaign.toml").write_text(
        f'[plant]\nname = "rig"\nmass_kg = {CE152.mass_kg}\ntravel_m = {CE152.travel_m}\n'
        f"x_max_m = {CE152.travel_m + CE152.coil_plane_above_stop_m}\n"
        '[[recording]]\nfile = "f.csv"\nkind = "closed-loop"\nuse = "judge"\nskip_s = 1.0\n'
        'columns = { u_c = "u", i_c = "i", x = { column = "gap_mm", scale = -1e-3, offset = 5.7e-3 } }\n'
    )
    model = model_file(tmp_path, {"air-gap-offset": 8e-4})

    for recording in (tmp_path / "f.csv", Path("f.csv")):
        assert run(model, recording, "--campaign", tmp_path, "--json") == 0
        summary = json.loads(capsys.readouterr().out)

        assert summary["rmse_m"] < 1.2e-5
        assert summary["samples"] == len(gap_flight.t) - 500
    assert run(model, "other.csv", "--campaign", tmp_path) == 2
    assert "Name one of: f.csv" in single_line(capsys)
    assert run(model, tmp_path / "f.csv") == 2
    assert "'u_c'" in single_line(capsys)


def test_lost_samples_and_contacts_are_left_out_and_counted(tmp_path: Path, gap_flight: Record) -> None:
    x = gap_flight.x.copy()
    x[600:700] = 0.0
    keep = np.ones(len(x), np.bool_)
    keep[1200:1204] = False  # a row more than is bridged
    record = replace(gap_flight, **{name: getattr(gap_flight, name)[keep] for name in NAMES if name != "x"}, x=x[keep])

    prediction = predict(true_model(effects={"air-gap-offset": 8e-4}), record, AHEAD)

    assert len(prediction.x) + sum(count for _, count in prediction.left_out) == len(record.t)
    assert prediction.rmse_m is not None
    assert prediction.rmse_m < 1.2e-5
    predicted = np.isin(record.t, prediction.t)
    settling_ticks = AHEAD + round(0.1 / TICK_S)
    assert not predicted[599 : 700 + settling_ticks].any()
    assert not predicted[1200 : 1200 + settling_ticks - 1].any()
    assert predicted[1200 + settling_ticks + 1 :].all()


def single_line(capsys: pytest.CaptureFixture[str]) -> str:
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("board51 predict: ")
    return error


def test_bad_input_is_one_line(tmp_path: Path, gap_flight: Record, capsys: pytest.CaptureFixture[str]) -> None:
    recording, model = files(tmp_path, gap_flight)[0], model_file(tmp_path)
    short = tmp_path / "short.csv"
    short.write_text("\n".join(recording.read_text().splitlines()[:8]))
    motionless = replace(gap_flight, x=np.zeros(len(gap_flight.t)))
    (tmp_path / "still").mkdir()

    for arguments, says in (
        ((model, recording, "--horizon", "0"), "--horizon 0"),
        ((model, tmp_path / "no.csv"), "no.csv"),
        ((tmp_path / "no.json", recording), "no.json"),
        ((model, short), "too few"),
        ((model, recording, "--out", tmp_path / "no" / "p.csv"), "cannot be written"),
    ):
        assert run(*arguments) == 2
        assert says in single_line(capsys)
    assert run(model, files(tmp_path / "still", motionless)[0]) == 1
