"""The scripts for Python, MATLAB and Octave fly as the twin does."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.harness.twin.exported import law_for, pushes, steps, twin_flight, with_causes, with_curve
from twin.control_design.design import Design, Specification, design
from twin.estimation.record import FloatArray
from twin.export import controller
from twin.export.formats import Exported, export
from twin.model.extension import base, vector
from twin.model.parameters import Model
from twin.model.rates import rates

MODELS = {
    "no causes": Model.load("ce152"),
    "an equation": with_causes("quadratic-drag", "motional-emf", "position-sensor-nonlinearity", "slew-rate-limit"),
    "late, dry": with_causes(
        "actuation-delay", "sampling-delay", "coulomb-friction", sizes={"actuation-delay": 2.3e-3}
    ),
    "remainder": with_curve("force-over-height", 0.5e-3, 5e-3),
}
SHARE = 1e-9  # of the range
READINGS = [3, 4, 2, 5]  # of the twin's flight: i, x, v, u as `tick` returns them


def exported(model: Model, to: str, folder: Path) -> Exported:
    made = design(model, Specification())
    files = export(model, controller.of_design(made, u_max_v=5.0), to)  # type: ignore[arg-type]  # a known word
    folder.mkdir()
    for name, content in files.files.items():
        (folder / name).write_bytes(content)
    return files


def designed(model: Model) -> Design:
    return design(model, Specification())


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shifted(flight: FloatArray) -> FloatArray:
    """The readings at the beginning of each tick but the first, and the u of that tick."""
    return np.column_stack([flight[:-1, READINGS[:3]], flight[1:, READINGS[3]]])


@pytest.mark.parametrize("closed_loop", [True, False])
@pytest.mark.parametrize("name", MODELS)
def test_the_python_module_flies_as_the_twin(name: str, closed_loop: bool, tmp_path: Path) -> None:
    model = MODELS[name]
    law = law_for(model)
    exported(model, "python", tmp_path / "rig")
    drive = steps(law, 1.0) if closed_loop else pushes(law, 1.0)
    expected = shifted(twin_flight(model, law, drive, closed_loop=closed_loop))

    got = loaded(tmp_path / "rig" / "rig.py").simulate(drive, closed_loop)[1:]

    assert np.max(np.abs(got - expected) / np.ptp(expected, axis=0)) < SHARE


def test_the_equation_in_python_is_that_of_the_model(tmp_path: Path) -> None:
    model = MODELS["an equation"]
    exported(model, "python", tmp_path / "rig")
    state = 0.5, 2e-3, 0.03, 1.7

    got = loaded(tmp_path / "rig" / "rig.py").rates(*state)

    assert got == pytest.approx(rates(base(model), vector(model.causes), *state), rel=1e-12)


@pytest.mark.parametrize("to", ["python", "matlab"])
def test_a_missing_equation_is_told(to: str, tmp_path: Path) -> None:
    notes = exported(MODELS["late, dry"], to, tmp_path / "rig").notes

    assert (
        "the differential equation is left out. coulomb-friction: a ball that sticks follows no differential equation"
        in (notes)
    )
    assert not (tmp_path / "rig" / "rig_ode.m").exists()


@pytest.mark.slow
def test_the_python_figure_needs_no_product(tmp_path: Path) -> None:
    """In a process that cannot import the twin: gains as designed, and the figure's flight."""
    model = MODELS["no causes"]
    exported(model, "python", tmp_path / "rig")
    script = (
        "import sys; sys.modules['twin'] = None\n"
        "import figure_11; print(*figure_11.gains()); print(figure_11.figure_11(0.0)[2][-1, 1])"
    )

    process = subprocess.run(
        [sys.executable, "-P", "-c", f"import sys; sys.path.insert(0, '.')\n{script}"],
        cwd=tmp_path / "rig",
        capture_output=True,
        text=True,
        check=True,
    )

    gains, x = process.stdout.splitlines()
    assert [float(k) for k in gains.split()] == pytest.approx(designed(model).gains, rel=1e-9)
    assert float(x) == pytest.approx(2.85e-3 - 0.57e-3, rel=1e-3)


octave = pytest.mark.skipif(shutil.which("octave") is None, reason="no octave is installed: apt-get install octave")


def run_octave(folder: Path, script: str) -> FloatArray:
    """Return the output of a script as numbers."""
    process = subprocess.run(
        ["octave", "--no-gui", "--no-init-file", "--quiet", "--eval", f"format long; {script}"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return np.array([float(word) for word in process.stdout.split()])


@octave
@pytest.mark.slow
@pytest.mark.parametrize("closed_loop", [True, False])
@pytest.mark.parametrize("name", MODELS)
def test_octave_flies_as_the_twin(name: str, closed_loop: bool, tmp_path: Path) -> None:
    model = MODELS[name]
    law = law_for(model)
    exported(model, "matlab", tmp_path / "rig")
    drive = steps(law, 1.0) if closed_loop else pushes(law, 1.0)
    np.savetxt(tmp_path / "rig" / "drive.txt", drive, fmt="%.17g")
    expected = shifted(twin_flight(model, law, drive, closed_loop=closed_loop))

    printed = run_octave(
        tmp_path / "rig",
        "m = rig_parameters(); d = load('drive.txt'); M = rig_begin(m, m.i_0, m.x_0, 0, m.u_0);"
        f"for k = 1:numel(d), [M, i, x, v, u] = rig_tick(m, M, {str(closed_loop).lower()}, d(k), d(k));"
        " printf('%.17g %.17g %.17g %.17g\\n', i, x, v, u); end",
    ).reshape(-1, 4)[1:]

    assert np.max(np.abs(printed - expected) / np.ptp(expected, axis=0)) < SHARE


@octave
@pytest.mark.slow
def test_octave_has_equation_gains_and_figure(tmp_path: Path) -> None:
    model = MODELS["an equation"]
    exported(model, "matlab", tmp_path / "rig")
    state = 0.5, 2e-3, 0.03, 1.7

    printed = run_octave(
        tmp_path / "rig",
        "m = rig_parameters(); s = rig_linear();"
        "printf('%.17g ', rig_ode(0, [0.5; 2e-3; 0.03], 1.7, m));"
        "printf('%.17g ', lqi_gains(s.Phi_prompt, s.Gamma_prompt, s.T_s, m.Q, m.R));"
        "[t, x] = figure_11(0); printf('%.17g ', x(end));",
    )

    assert printed[:3] == pytest.approx(rates(base(model), vector(model.causes), *state), rel=1e-12)
    assert printed[3:7] == pytest.approx(designed(model).gains, rel=1e-6)
    assert printed[7] == pytest.approx(2.85e-3 - 0.57e-3, rel=1e-3)
