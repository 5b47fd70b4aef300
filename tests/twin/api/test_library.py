"""`from twin import ...`: quick to import, the same answers as the commands, figures and arrays."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import board51
from gateway.emulator.plant.constants import CE152
from protocol.errors import DataError, UsageError
from tests.harness.twin.emulated_campaign import run_campaign
from twin import Campaign, Model, design, diagnose, export_model, identify, predict, validate
from twin.estimation.record import Record

NAMES = ("t", "u_c", "i_c", "x", "x_ref")


def python(code: str) -> None:
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr


def write(folder: Path, record: Record) -> str:
    values = np.column_stack([getattr(record, name) for name in NAMES])
    lines = [",".join(NAMES), *(",".join(f"{value:.9g}" for value in row) for row in values)]
    (folder / f"{record.name}.csv").write_text("\n".join(lines) + "\n")
    return f"{record.name}.csv"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flights of a rig as the model has it, and points of rest of one whose coil sits higher."""
    folder = tmp_path_factory.mktemp("campaign")
    _, sawtooth, multisine, prbs = run_campaign(CE152, seed=5, flight_s=5.0)
    plant = f'name = "ce152"\nmass_kg = {CE152.mass_kg}\ntravel_m = {CE152.travel_m}\n'
    x_max = f"x_max_m = {CE152.travel_m + CE152.coil_plane_above_stop_m}\n"
    text = f"[plant]\n{plant}{x_max}"
    for record, use in ((sawtooth, "fit"), (multisine, "fit"), (prbs, "judge")):
        text += f'[[recording]]\nfile = "{write(folder, record)}"\nkind = "{record.kind}"\nuse = "{use}"\n'
    (folder / "campaign.toml").write_text(text)
    x = np.linspace(0.5e-3, 5.0e-3, 8)
    rest = "i_c,x\n" + "".join(f"{250.0 * (CE152.travel_m + 2.4e-3 - x_m):.6f},{x_m:.6f}\n" for x_m in x)
    (folder / "rest.csv").write_text(rest)
    (folder / "rest.toml").write_text(
        f'[plant]\n{plant}[[recording]]\nfile = "rest.csv"\nkind = "equilibria"\nuse = "fit"\n'
    )
    return folder


@pytest.fixture(scope="module")
def model(folder: Path) -> Model:
    return identify(folder).model


def printed(capsys: pytest.CaptureFixture[str], *words: str | Path) -> object:
    capsys.readouterr()
    assert board51.main([*map(str, words), "--json"]) in (0, 1)
    return json.loads(capsys.readouterr().out)


def plain(data: object) -> object:
    """Return the value as JSON has it: tuples are lists."""
    return json.loads(json.dumps(data))


def test_importing_the_package_loads_no_numerics() -> None:
    python(
        "import sys, twin; from twin import Campaign, Model\n"
        "loaded = {'numba', 'scipy', 'matplotlib', 'numpy'} & set(sys.modules); assert not loaded, loaded"
    )


def test_an_export_is_what_the_command_writes(model: Model, tmp_path: Path) -> None:
    model.save(tmp_path / "model.json")
    words = ["export-model", tmp_path / "model.json", "--to", "matlab", "--out", tmp_path / "command"]

    paths = export_model(model, "matlab").save(tmp_path / "library")

    assert board51.main([*map(str, words)]) == 0
    assert [path.read_bytes() for path in paths] == [(tmp_path / "command" / path.name).read_bytes() for path in paths]


def test_the_folder_of_the_recordings_may_be_text_as_each_other_path(
    folder: Path, model: Model, tmp_path: Path
) -> None:
    for name in ("campaign.toml", "rest.toml"):
        (tmp_path / name).write_text((folder / name).read_text())
    recording = Campaign.load(folder).recordings[0].file

    diagnosed = diagnose(tmp_path / "rest.toml", data=str(folder))
    predicted = predict(model, recording, campaign=tmp_path, data=str(folder))

    assert diagnosed.verdict == diagnose(folder / "rest.toml").verdict
    assert np.array_equal(predicted.x_hat_m, predict(model, folder / recording).x_hat_m, equal_nan=True)


def test_a_model_is_what_the_command_writes(
    folder: Path, model: Model, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    identification = identify(Campaign.load(folder))
    model.save(tmp_path / "model.json")

    assert plain(identification.to_json()) == printed(capsys, "identify", folder, "--quiet")
    assert identification.usable
    assert Model.load(tmp_path / "model.json").to_json() == model.to_json()
    assert identification.table().startswith("K_A") or "K_A" in identification.table()


@pytest.mark.slow
def test_a_validation_is_what_the_command_writes(
    folder: Path, model: Model, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model.save(tmp_path / "model.json")

    validation = validate(folder, model)
    validation.save(tmp_path / "saved", title="Validation of model.json on ce152")

    output = printed(capsys, "validate", folder, "--model", tmp_path / "model.json", "--out", tmp_path / "out")
    assert plain(validation.to_json()) == output
    for name in ("report.html", "validation.json"):
        assert (tmp_path / "saved" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    assert validation.horizon_s.shape == validation.rmse_m.shape == validation.floor_m.shape
    figures = validation.figures()
    assert {"prediction", "residuals"} <= set(figures)
    assert all(isinstance(figure, Figure) for figure in figures.values())


def test_a_prediction_is_what_the_command_writes(
    folder: Path, model: Model, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model.save(tmp_path / "model.json")

    prediction = predict(model, folder / "prbs.csv", horizon_samples=5, campaign=folder)

    words: list[str | Path] = [
        "predict",
        tmp_path / "model.json",
        folder / "prbs.csv",
        "--campaign",
        folder,
        "--horizon",
        "5",
    ]
    assert plain(prediction.to_json()) == printed(capsys, *words, "--out", tmp_path / "pred.csv")
    assert prediction.to_csv() == (tmp_path / "pred.csv").read_text()
    assert prediction.t_s.shape == prediction.x_m.shape == prediction.x_hat_m.shape
    assert prediction.rmse_m == pytest.approx(np.sqrt(np.mean((prediction.x_m - prediction.x_hat_m) ** 2)))


def test_a_design_is_what_the_command_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    controller = design("ce152", x_m=2e-3)

    output = printed(capsys, "design", "ce152", "--operating-point", "2e-3", "--out", tmp_path / "controller.json")
    assert plain(controller.report()) == output
    assert plain(controller.to_json()) == json.loads((tmp_path / "controller.json").read_text())
    assert controller.gains.shape == (4,)
    assert controller.stable
    assert abs(controller.poles[0]) < 1.0


@pytest.mark.slow
def test_a_diagnosis_of_points_of_rest_is_what_the_command_writes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    diagnosis = diagnose(folder / "rest.toml")
    diagnosis.save(tmp_path / "saved")

    output = printed(capsys, "diagnose", folder / "rest.toml", "--quiet", "--out", tmp_path / "out")
    assert plain(diagnosis.to_json()) == output
    for name in ("report.html", "diagnosis.json", "extended_model.json"):
        assert (tmp_path / "saved" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    assert "air-gap-offset" in diagnosis.causes
    assert list(diagnosis.figures()) == ["points"]


@pytest.mark.slow
def test_a_diagnosis_of_flights_is_what_the_command_writes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    diagnosis = diagnose(folder, quick=True)
    diagnosis.save(tmp_path / "saved")

    output = printed(capsys, "diagnose", folder, "--quick", "--quiet", "--out", tmp_path / "out")
    library_output = plain(diagnosis.to_json())
    for timed in (library_output, output):  # wall times differ from run to run
        assert isinstance(timed, dict)
        timed.pop("stages_s", None)
    assert library_output == output
    extended = (tmp_path / "saved" / "extended_model.json").read_text()
    assert extended == (tmp_path / "out" / "extended_model.json").read_text()
    assert {"prediction", "trace", "error"} <= set(diagnosis.figures())
    assert diagnosis.summary(None).startswith(diagnosis.sentence)


def test_errors_are_the_project_s_with_a_remedy(folder: Path, model: Model, tmp_path: Path) -> None:
    with pytest.raises(DataError) as absent:
        identify(tmp_path / "nowhere")
    with pytest.raises(DataError, match="is not one of its recordings"):
        predict(model, "elsewhere.csv", campaign=folder)
    with pytest.raises(UsageError):
        predict(model, folder / "prbs.csv", horizon_samples=0)
    with pytest.raises(UsageError):
        diagnose(folder, share=0.0)
    with pytest.raises(UsageError):
        design(model, u_max_v=-1.0)
    with pytest.raises(UsageError):
        model.save(tmp_path / "no" / "such" / "folder.json")

    assert absent.value.remedy
