"""Bad input of `board51 diagnose`: one clear line or a clear statement, no traceback, never a wrong name in silence."""

from __future__ import annotations

import gzip
import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import board51
from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.twin.independent_plant import Ball
from tests.harness.twin.true_theta import TRUE
from twin.estimation.record import FloatArray
from twin.evidence.gather import gather
from twin.evidence.sensor_noise import noise_errors, sensor_noise
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor, floor_of
from twin.model.parameters import Model
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings

BALL = Ball()


@pytest.fixture(scope="module")
def null(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with nothing hidden."""
    folder = tmp_path_factory.mktemp("campaigns") / "null"
    make_campaign(folder, effects={}, seed=31, plant="independent", quick=True)
    return folder


@pytest.fixture
def folder(null: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(null, tmp_path / "null"))


def rewrite(path: Path, change: Callable[[list[str], FloatArray], tuple[list[str], FloatArray]]) -> None:
    """Change a table."""
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    names = [name.strip('"') for name in lines[0].split(",")]
    rows = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines[1:]])
    names, rows = change(names, rows)
    body = "\n".join(",".join(f"{cell:.9g}" for cell in row) for row in rows)
    path.write_bytes(gzip.compress((",".join(names) + "\n" + body + "\n").encode()))


def keep(folder: Path, *files: str) -> None:
    """Leave these recordings in campaign.toml."""
    head, *entries = (folder / "campaign.toml").read_text().split("[[recording]]\n")
    retained = [entry for entry in entries if any(f'"{file}.csv.gz"' in entry for file in files)]
    (folder / "campaign.toml").write_text(head + "".join("[[recording]]\n" + entry for entry in retained))


def uses(folder: Path, use: str) -> None:
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace('"fit"', f'"{use}"').replace('"judge"', f'"{use}"'))


def column(folder: Path, name: str, value: float | None) -> None:
    """Fill a column of every table, or take it out."""

    def change(names: list[str], rows: FloatArray) -> tuple[list[str], FloatArray]:
        if name not in names:
            return names, rows
        index = names.index(name)
        if value is None:
            return names[:index] + names[index + 1 :], np.delete(rows, index, axis=1)
        rows[:, index] = value
        return names, rows

    for path in sorted(folder.glob("*.csv.gz")):
        rewrite(path, change)


def constant_x(value: float) -> Callable[[list[str], FloatArray], tuple[list[str], FloatArray]]:
    def change(names: list[str], rows: FloatArray) -> tuple[list[str], FloatArray]:
        rows[:, 3] = value
        return names, rows

    return change


def run(folder: Path, *more: str, quick: bool = True) -> int:
    return board51.main(["diagnose", str(folder), *["--quick"] * quick, "--quiet", *more])


def refused(capsys: pytest.CaptureFixture[str], folder: Path, *more: str) -> str:
    """The one line on stderr."""
    code, captured = run(folder, *more), capsys.readouterr()
    assert code == 2, captured.out
    assert captured.out == ""
    assert captured.err.count("\n") == 1, captured.err
    assert captured.err.startswith("board51 diagnose: ")
    return captured.err


def answered(capsys: pytest.CaptureFixture[str], folder: Path, *more: str, quick: bool = True) -> dict[str, Any]:
    code, captured = run(folder, "--json", *more, quick=quick), capsys.readouterr()
    data: dict[str, Any] = json.loads(captured.out)
    assert code == (1 if data["verdict"] == "unknown-cause" else 0)
    return data


def test_a_second_of_flight_is_too_little(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep(folder, "closed_loop_2")
    rewrite(folder / "closed_loop_2.csv.gz", lambda names, rows: (names, rows[:500]))

    line = refused(capsys, folder)

    assert "hold 1 s of flight: too little" in line
    assert "Record at least 2 s" in line


def test_judge_recordings_alone_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    uses(folder, "judge")

    assert 'no recording has use = "fit"' in refused(capsys, folder)


@pytest.mark.slow
def test_without_judge_recordings_there_is_a_diagnosis_and_no_gain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "drag"
    make_campaign(folder, effects={"quadratic-drag": 1.0}, seed=104, plant="independent", quick=True)
    uses(folder, "fit")

    data = answered(capsys, folder)

    assert [cause["name"] for cause in data["causes"]] == ["quadratic-drag"]
    assert data["gain"] is None
    assert any('no recording has use = "judge"' in warning for warning in data["warnings"])


@pytest.mark.parametrize(
    ("field", "value"), [("mass_kg", 9.9e-3), ("travel_m", 5e-3), ("x_max_m", 9.5e-3), ("gravity_m_s2", 9.5)]
)
def test_a_model_of_another_plant_is_refused_by_its_field(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, field: str, value: float
) -> None:
    plant = load(folder).plant
    base: Model = Model.load(Path(board51.__file__).parent / "twin" / "model" / "ce152.json")
    same_plant = replace(
        base.plant,
        mass_kg=plant.mass_kg,
        travel_m=plant.travel_m,
        x_max_m=plant.x_max_m,
        gravity_m_s2=plant.gravity_m_s2,
    )
    change: dict[str, Any] = {field: value}
    model = replace(base, plant=replace(same_plant, **change))
    (tmp_path / "m.json").write_text(json.dumps(model.to_json()))

    line = refused(capsys, folder, "--model", str(tmp_path / "m.json"))

    assert "another plant" in line
    assert f"its {field} is {value:g}" in line


@pytest.mark.slow
def test_a_recording_of_another_rig_is_named_and_left_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_campaign(tmp_path / "other", effects={}, seed=77, plant="independent", quick=True)
    shutil.copy(tmp_path / "other" / "closed_loop_3.csv.gz", folder)
    keep(folder, "rest", "step_1", "ramp", *(f"closed_loop_{n}" for n in range(1, 7)))

    data = answered(capsys, folder)

    assert data["verdict"] == "model-adequate"
    assert "closed_loop_3.csv.gz contradicts the others and was left out" in data["sentence"]
    assert data["causes"] == []


@pytest.mark.sample
def test_an_effect_that_begins_in_the_middle_is_named_with_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_campaign(
        tmp_path / "late",
        effects={"constant-force": 0.012},
        seed=103,
        plant="emulator",
        quick=True,
        begins_with="closed_loop_3",
    )
    keep(tmp_path / "late", "rest", "step_1", "ramp", *(f"closed_loop_{n}" for n in range(1, 9)))

    data, hasty = answered(capsys, tmp_path / "late", quick=False), answered(capsys, tmp_path / "late")

    assert hasty["verdict"] == "unknown-cause"
    assert any("--quick did not examine whether an effect begins" in warning for warning in hasty["warnings"])
    (cause,) = data["causes"]
    assert cause["name"] == "constant-force"
    assert cause["begins_in"] == "closed_loop_3.csv.gz"
    assert cause["parameters"]["force_n"]["value"] == pytest.approx(0.012, rel=0.02)
    assert "from closed_loop_3.csv.gz on" in data["sentence"]
    assert any("absent up to closed_loop_2.csv.gz" in warning for warning in data["warnings"])
    assert data["gain"]["judge"]["excess_removed"] > 0.9


def test_without_x_the_amplifier_alone_is_judged(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep(folder, *(f"step_{n}" for n in range(1, 7)))

    data = answered(capsys, folder)

    assert data["verdict"] == "model-adequate"
    assert data["sentence"].startswith("For the amplifier only")
    why = {entry["name"]: entry["why"] for entry in data["not_testable"]}
    assert why["air-gap-offset"] == "no recording has x"
    assert why["position-sensor-lag"] == "no recording has x"
    assert "amplifier-offset" not in why
    assert data["gain"] is None


@pytest.mark.parametrize("name", ["i_c", "u_c", "x"])
def test_a_missing_column_is_named_with_its_file(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    column(folder, name, None)

    line = refused(capsys, folder)

    assert f"has no column '{name}'" in line
    assert ".csv.gz" in line


@pytest.mark.parametrize("name", ["i_c", "u_c"])
def test_a_column_without_numbers_is_said(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    keep(folder, "closed_loop_1", "closed_loop_2", "closed_loop_5")
    column(folder, name, float("nan"))

    line = refused(capsys, folder)

    assert "no recording shows i_c following u_c" in line


@pytest.mark.parametrize("content", [b"", b"\n", b"t,u_c,i_c,x,x_ref\n", b"\x00\x01\x02" * 50])
def test_an_empty_file_is_named(folder: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    (folder / "closed_loop_2.csv.gz").write_bytes(gzip.compress(content))

    assert "closed_loop_2.csv.gz" in refused(capsys, folder)


@pytest.mark.slow
def test_useless_recordings_give_no_false_name(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep(folder, "rest", "step_1", "step_3", "step_5", "ramp", *(f"closed_loop_{n}" for n in (1, 2, 3, 4, 6, 7)))
    rewrite(folder / "closed_loop_2.csv.gz", lambda names, rows: (names, rows[:2]))
    rewrite(folder / "closed_loop_3.csv.gz", constant_x(math.nan))

    data = answered(capsys, folder)

    assert data["causes"] == []
    for n in (2, 3):
        assert any(f"closed_loop_{n}.csv.gz" in warning for warning in data["warnings"])


@pytest.mark.slow
def test_a_recording_of_a_constant_x_gives_no_false_name(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite(folder / "closed_loop_2.csv.gz", constant_x(2.8e-3))

    data = answered(capsys, folder)

    assert data["causes"] == []
    assert any("closed_loop_2.csv.gz" in warning for warning in data["warnings"])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bits", "wild"])
def test_wild_readings_give_no_false_name(folder: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    rng = np.random.default_rng(5)

    def change(names: list[str], rows: FloatArray) -> tuple[list[str], FloatArray]:
        hit = rng.random(len(rows)) < (0.01 if kind == "bits" else 0.003)
        n = int(hit.sum())
        bit = rng.choice((-1.0, 1.0), n) * 1.4e-6 * 2.0 ** rng.integers(4, 10, n)
        rows[hit, 3] = rows[hit, 3] + bit if kind == "bits" else rng.uniform(-0.01, 0.01, n)
        return names, rows

    for path in sorted(folder.glob("closed_loop_*.csv.gz")):
        rewrite(path, change)

    assert answered(capsys, folder)["causes"] == []


@pytest.mark.slow
def test_samples_at_varying_times_are_taken_as_they_are(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Samples are left out where u_c stands still: what was in force in between is known."""
    rng = np.random.default_rng(6)

    def change(names: list[str], rows: FloatArray) -> tuple[list[str], FloatArray]:
        moves = np.append(True, rows[1:, 1] != rows[:-1, 1])
        return names, rows[moves | (rng.random(len(rows)) < 0.6)]

    keep(folder, "rest", "step_1", "step_3", "step_5", "ramp", "open_loop", *(f"closed_loop_{n}" for n in (2, 4, 6, 7)))
    rewrite(folder / "open_loop.csv.gz", change)

    data = answered(capsys, folder)

    assert data["verdict"] in ("model-adequate", "causes-found")
    assert [cause["name"] for cause in data["causes"]] in ([], ["lost-samples"])
    assert any("samples are missing" in warning for warning in data["warnings"])


def test_the_sensor_noise_is_found_at_rest_and_makes_the_floor(null: Path) -> None:
    """What one standard error of the noise level makes must not count as something that a model lacks."""
    campaign = load(null)
    evidence = gather(read_campaign(campaign), campaign.plant)

    sigma_i, sigma_x = sensor_noise(evidence)
    errors = np.array(noise_errors(evidence))
    criterion = Criterion(evidence, campaign.plant, 2e-3, workers=1)
    try:
        floor = floor_of(criterion, TRUE)
    finally:
        criterion.close()

    assert floor.measured
    assert (floor.sigma_i_c_a, floor.sigma_x_m) == (sigma_i, sigma_x)
    assert 0.7e-3 < floor.sigma_i_c_a < 4.2e-3  # the rigs are drawn from 0.8 to 4 mA, 2.5 to 12 um
    assert 2.3e-6 < floor.sigma_x_m < 12.5e-6
    assert np.all((0.0 < errors) & (errors < 0.1))
    assert not floor.material(floor.loglik - float(errors @ floor.counts))
    assert floor.material(floor.loglik - 4.0 * float(np.maximum(errors, settings.NOISE_TOLERANCE) @ floor.counts))
    assert Floor(sigma_i_c_a=1.0, sigma_x_m=1.0, measured=True, counts=(50, 50)).material(-3.0)


def test_the_stops_are_where_the_sensor_shows_them(null: Path) -> None:
    """A displaced sensor shows the lower stop displaced; ramps off a platform give lift-off currents and no stop."""
    campaign = load(null)
    plant, records = campaign.plant, read_campaign(campaign)
    shifted = [replace(record, x=record.x + 3e-4) for record in records]
    ramp = next(record for record in records if record.kind == "sawtooth")
    lifted = [
        replace(ramp, name=f"platform_{n}", x=np.maximum(ramp.x, height)) for n, height in enumerate((0.4e-3, 1.2e-3))
    ]

    plain, displaced = gather(records, plant), gather(shifted, plant)

    assert plain.low_m == pytest.approx(0.0, abs=2e-5)
    assert displaced.low_m == pytest.approx(3e-4, abs=2e-5)
    assert gather(lifted, plant).low_m is None


def test_a_ball_that_rests_beyond_the_range_of_its_sensor_lies_on_no_platform(null: Path) -> None:
    """A sensor that reads 0.3 mm too low shows the end of its range, and no lift-off from there."""
    campaign = load(null)
    plant, records = campaign.plant, read_campaign(campaign)
    beyond = gather([replace(record, x=np.maximum(record.x - 3e-4, -5e-5)) for record in records], plant)

    assert beyond.statics == ()
    assert beyond.low_m is None
