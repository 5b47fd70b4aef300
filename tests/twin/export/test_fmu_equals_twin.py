"""An FMU simulates the rig as the twin does, to a billionth of each range."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from tests.harness.twin.exported import (
    OUTPUTS,
    T_S,
    law_for,
    pushes,
    steps,
    twin_flight,
    with_causes,
    with_curve,
)
from tests.harness.twin.importer import flown, needs_compiler
from twin.control import LawNumbers
from twin.estimation.record import FloatArray
from twin.export.fmu.pack import fmu
from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.cause import Cause
from twin.model.parameters import Model

pytestmark = needs_compiler
Made = Callable[[str, str], Path]
SHARE = 1e-9  # of the range of each output
SECONDS = 10.0

MODELS = {
    "no causes": Model.load("ce152"),
    "another rig": Model.load("magnetoshield"),
    "late, dry, offset": with_causes(
        "actuation-delay",
        "sampling-delay",
        "coulomb-friction",
        "position-sensor-offset",
        "current-sensor-offset",
        "air-gap-offset",
        sizes={"actuation-delay": 2.3e-3, "sampling-delay": 0.7e-3},
    ),
    "hidden states": with_causes(
        "eddy-current-lag",
        "position-sensor-lag",
        "motional-emf",
        "slew-rate-limit",
        "amplifier-gain-drift",
        "second-time-constant",
    ),
    "two time constants": with_causes(
        "second-time-constant",
        "eddy-current-lag",
        "current-sensor-lag",
        sizes={"eddy-current-lag.slow": 0.3, "second-time-constant": 0.2},
    ),
    "remainder": with_curve("force-over-height", 0.5e-3, 5e-3),
}


@cache
def law(name: str) -> LawNumbers:
    return law_for(MODELS[name])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The FMU of a model of this name, compiled once."""

    @cache
    def make(name: str, fmi: str) -> Path:
        path = tmp_path_factory.mktemp("made") / "rig.fmu"
        path.write_bytes(fmu(MODELS[name], law(name), fmi=fmi).content)
        return path

    return make


def differences(model: Model, law: LawNumbers, path: Path, *, closed_loop: bool) -> FloatArray:
    """Largest difference of each output, as a share of its range in the twin."""
    drive = steps(law, SECONDS) if closed_loop else pushes(law, SECONDS)
    expected = twin_flight(model, law, drive, closed_loop=closed_loop)
    got = flown(path, drive, OUTPUTS, closed_loop=closed_loop, T_s=T_S)
    return np.asarray(np.abs(got - expected).max(axis=0) / np.ptp(expected, axis=0))


@pytest.mark.parametrize("closed_loop", [True, False])  # open loop: from stop to stop
@pytest.mark.parametrize(("name", "fmi"), [*((name, "2.0") for name in MODELS), ("late, dry, offset", "3.0")])
def test_it_flies_as_the_twin(name: str, fmi: str, closed_loop: bool, made: Made) -> None:
    assert differences(MODELS[name], law(name), made(name, fmi), closed_loop=closed_loop).max() < SHARE


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize(
    "name",
    [
        *("no causes", "late, dry, offset", "hidden states", "remainder"),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("another rig", "two time constants")),
    ],
)
def test_the_standard_finds_nothing_wrong(name: str, fmi: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.fmu"
    path.write_bytes(fmu(MODELS[name], law(name), fmi=fmi, compiler="").content)

    assert validate_fmu(str(path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("cause", CATALOGUE, ids=lambda cause: cause.name)
@pytest.mark.parametrize("closed_loop", [True, False])
def test_each_cause(cause: Cause, closed_loop: bool, tmp_path: Path) -> None:
    model, path = with_causes(cause.name), tmp_path / "rig.fmu"
    path.write_bytes(fmu(model, law("no causes")).content)

    assert differences(model, law("no causes"), path, closed_loop=closed_loop).max() < SHARE
