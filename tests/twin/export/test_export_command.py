"""`board51 export-model` as its user meets it."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import pytest

import board51
from tests.harness.twin.exported import with_causes
from twin import export_model
from twin.export.formats import Format
from twin.model.parameters import Model


def test_an_fmu_has_description_and_sources(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rig.fmu"

    code = board51.main(["export-model", "ce152", "--to", "fmu", "--compiler", "", "--out", str(out)])

    assert code == 0
    printed = capsys.readouterr()
    assert printed.out == f"{out}\n"
    assert "no C compiler" in printed.err
    with zipfile.ZipFile(out) as archive:
        assert archive.namelist() == [
            "modelDescription.xml",
            *(f"sources/{name}" for name in ("fmi2.c", "model.c", "model.h", "slave.c", "slave.h")),
        ]
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    K_A = next(variable for variable in root.iter("ScalarVariable") if variable.get("name") == "K_A")
    real = K_A.find("Real")
    assert real is not None
    assert (real.get("unit"), real.get("start"), real.get("min")) == ("A/V", "0.297", "0.001")


def test_the_same_model_gives_the_same_file(tmp_path: Path) -> None:
    first, second = tmp_path / "1.fmu", tmp_path / "2.fmu"

    for out in (first, second):
        board51.main(["export-model", "ce152", "--to", "fmu", "--compiler", "", "--out", str(out)])

    assert first.read_bytes() == second.read_bytes()


def test_what_a_simulation_leaves_out_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "model.json"
    with_causes("periodic-disturbance").save(model)

    code = board51.main(["export-model", str(model), "--to", "fmu", "--compiler", "", "--out", str(tmp_path / "a.fmu")])

    assert code == 0
    assert "periodic-disturbance is not simulated: its phase is not known" in capsys.readouterr().err


def test_the_law_of_a_controller_file(tmp_path: Path) -> None:
    file, out = tmp_path / "controller.json", tmp_path / "rig.fmu"
    board51.main(["design", "ce152", "--operating-point", "2e-3", "--out", str(file)])
    gains = json.loads(file.read_text())["gains"]

    command = ["export-model", "ce152", "--to", "fmu", "--compiler", "", "--out", str(out), "--controller", str(file)]
    assert board51.main(command) == 0

    with zipfile.ZipFile(out) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    starts = {variable.get("name"): variable[0].get("start") for variable in root.iter("ScalarVariable")}
    assert starts["law.x_0"] == "0.002"
    assert [float(starts[f"law.{name}"] or "nan") for name in ("k_i", "k_x", "k_v", "k_s")] == [*gains[:3], -gains[3]]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{}", "law"),
        ('{"law": "lqi", "gains": [1, 2, 3]}', "gains"),
        ("[", "controller.json"),
    ],
)
def test_a_bad_controller_file_is_named(
    content: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "controller.json"
    file.write_text(content)

    assert board51.main(["export-model", "ce152", "--to", "fmu", "--controller", str(file)]) == 2

    assert says in capsys.readouterr().err


def test_a_placeholder_is_not_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.json"
    content = Model.load("ce152").to_json()
    content["parameters"]["K_c"]["verdict"] = "not-identifiable"
    path.write_text(json.dumps(content))

    assert board51.main(["export-model", str(path), "--to", "fmu"]) == 2

    assert "K_c" in capsys.readouterr().err


@pytest.mark.parametrize("to", get_args(Format))
def test_a_name_is_a_name_in_every_language(to: Format, tmp_path: Path) -> None:
    """A model file may come from a stranger: its name must not become code."""
    name = 'a*/ stolen(); /* """ \n} end \\ % $x$ <b>'
    model = Model.load("ce152")
    model = replace(model, plant=replace(model.plant, name=name))

    files = export_model(model, to, compiler="").files

    text = zip_text(*files.values()) if to == "fmu" else "".join(data.decode() for data in files.values())
    assert not any(part in text for part in ("*/ stolen", '""" \n}', "stolen()", "<b>"))
    if to == "python":
        compile(files["rig.py"], "rig.py", "exec")


def zip_text(content: bytes) -> str:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return "".join(archive.read(name).decode() for name in archive.namelist())


def test_a_compiler_that_fails_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["export-model", "ce152", "--to", "fmu", "--compiler", "false"]) == 2

    assert "--compiler ''" in capsys.readouterr().err
