"""The model as LaTeX and as Modelica.

No Modelica compiler is in Debian, so the package is only checked for its structure here.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import board51
from tests.harness.twin.exported import with_causes, with_curve
from twin.export import controller
from twin.export.formats import Format, export
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Model

NAMED = [name for name, cause in BY_NAME.items() if cause.detector not in ("stated", "remainder")]
EQUATION = ("motional-emf", "slew-rate-limit", "force-exponent", "freewheel-diode", "position-dependent-inductance")


@pytest.fixture(scope="module")
def law(tmp_path_factory: pytest.TempPathFactory) -> controller.Controller:
    """Provide a control law from a file: not every model of this page has gains."""
    path = tmp_path_factory.mktemp("law") / "controller.json"
    board51.main(["design", "ce152", "--out", str(path)])
    return controller.of_file(path, u_max_v=5.0)


def text_of(model: Model, law: controller.Controller, to: Format) -> str:
    (content,) = export(model, law, to).files.values()
    return content.decode()


def test_latex_has_each_value_with_its_interval(law: controller.Controller) -> None:
    model = Model.load("ce152").to_json()
    model["parameters"]["K_c"] |= {"ci95": [2.7e-6, 2.8e-6], "verdict": "identified"}
    path = "model.json"

    from twin.model.parameters import model_from_dict

    text = text_of(model_from_dict(model, where=path), law, "latex")

    assert (
        r"$K_{c}$ & $2.751 \cdot 10^{-6}$ & $2.7 \cdot 10^{-6}$ to $2.8 \cdot 10^{-6}$ &"
        r" $\mathrm{N}\,\mathrm{m}^2/\mathrm{A}^2$ & identified \\"
    ) in text


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="no LaTeX is installed: apt-get install texlive-latex-base"
)
@pytest.mark.parametrize(
    "model", [with_causes(*NAMED), with_curve("force-over-speed", -0.1, 0.1)], ids=["causes", "curve"]
)
def test_latex_compiles_with_every_cause(model: Model, law: controller.Controller, tmp_path: Path) -> None:
    (tmp_path / "model.tex").write_text(text_of(model, law, "latex"))

    process = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "model.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        errors="replace",
    )

    assert process.returncode == 0, process.stdout[-2000:]
    assert (tmp_path / "model.pdf").stat().st_size > 10_000


@pytest.mark.parametrize(
    "model", [Model.load("ce152"), with_causes(*EQUATION), with_curve("force-over-height", 0.5e-3, 5e-3)]
)
def test_a_modelica_package_is_closed_and_calls_what_it_has(model: Model, law: controller.Controller) -> None:
    text = text_of(model, law, "modelica")

    code = re.sub(r'"[^"]*"', "", text)
    opened = re.findall(r"^\s*(?:package|model|function|record) (\w+)", code, re.MULTILINE)
    closed = re.findall(r"^\s*end (\w+);", code, re.MULTILINE)
    assert sorted(opened) == sorted(name for name in closed if name not in ("if", "when"))
    assert code.count("(") == code.count(")")
    statements = [line for line in code.splitlines() if ":=" in line or line.strip().startswith("(")]
    called = {name for line in statements for name in re.findall(r"\b(\w+)\(", line)} - {"if", "and", "or", "not"}
    built_in = {"abs", "min", "max", "exp", "sqrt", "log", "sin", "cos", "integer", "mod"}
    assert called - built_in <= set(opened)


def test_modelica_says_what_it_cannot_have(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.json"
    with_causes("coulomb-friction", "quadratic-drag", sizes={"coulomb-friction": 1e-3}).save(path)

    assert board51.main(["export-model", str(path), "--to", "modelica", "--out", str(tmp_path / "a.mo")]) == 2

    assert capsys.readouterr().err == (
        "board51 export-model: Modelica cannot express a part of this model. coulomb-friction: a ball that sticks"
        " follows no differential equation. Export with --to fmu, which Modelica tools import, or leave the cause out"
        " of the model.\n"
    )
    assert not (tmp_path / "a.mo").exists()
