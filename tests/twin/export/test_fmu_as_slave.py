"""An FMU under an importer that does not step by ticks, sets parameters in flight, or makes mistakes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import pytest
from fmpy.fmi1 import FMICallException

from tests.harness.twin.exported import T_S, law_for, with_causes
from tests.harness.twin.importer import Instance, needs_compiler, running
from twin.export.fmu.pack import fmu
from twin.model.parameters import Model

pytestmark = needs_compiler
Start = Callable[..., AbstractContextManager[Instance]]


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped CE 152 with dry friction and a delay."""
    model = with_causes("coulomb-friction", "actuation-delay")
    path = tmp_path_factory.mktemp("slave") / "rig.fmu"
    path.write_bytes(fmu(model, law_for(Model.load("ce152")), fmi=request.param).content)
    return path


@pytest.fixture
def start(made: Path, tmp_path: Path) -> Start:
    """Start it; no test unpacks into the folder of another."""
    return partial(running, Path(shutil.copy(made, tmp_path)))


def test_the_size_of_a_step_does_not_matter(start: Start) -> None:
    ends = []
    for duration_s in (T_S, 10 * T_S, 0.5 * T_S):
        with start({"x_ref": 3e-3}) as rig:
            for k in range(round(0.2 / duration_s)):
                rig.step(k * duration_s, duration_s)
            ends.append(rig.get("x", "v", "i", "u"))

    assert ends[0] == ends[1] == ends[2]


def test_a_step_back_to_a_kept_state_repeats_the_flight(start: Start) -> None:
    with start({"x_ref": 3e-3}) as rig:
        rig.step(0.0, 0.05)
        slave = rig.slave
        get = getattr(slave, "getFMUstate", None) or slave.getFMUState
        set_ = getattr(slave, "setFMUstate", None) or slave.setFMUState
        state = get()
        rig.step(0.05, 0.05)
        first = rig.get("x", "v")
        set_(state)
        rig.step(0.05, 0.05)

        assert rig.get("x", "v") == first


def test_a_parameter_may_change_in_flight(start: Start) -> None:
    """More gravity: the law must pull harder once it has settled."""
    with start({"coulomb_friction.force_n": 0.0}) as rig:
        rig.step(0.0, 1.0)
        (before,) = rig.get("i")
        rig.set("gravity", 11.0)
        rig.step(1.0, 2.0)

        assert rig.get("i")[0] == pytest.approx(before * (11.0 / 9.81) ** 0.5, rel=0.01)


def test_the_start_is_a_parameter(start: Start) -> None:
    with start({"start.x": 1e-3, "closed_loop": False, "u_c": 0.0, "start.i": 0.0, "start.u": 0.0}) as rig:
        assert rig.get("x", "v", "i") == [1e-3, 0.0, 0.0]
        rig.step(0.0, 1.0)

        assert rig.get("x", "y_x") == [0.0, 0.0]


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("T_A", -1.0, "T_A = -1 is not in 1e-07 .. 1. Check the unit"),
        ("x_ref", float("nan"), "x_ref = nan"),
        ("actuation_delay.delay_s", 1e-3, "cannot be set after the initialization"),
        ("x", 1e-3, "x cannot be set because it is an output"),
    ],
)
def test_a_wrong_value_is_refused_and_named(name: str, value: float, says: str, start: Start) -> None:
    with start() as rig:
        with pytest.raises(FMICallException):
            rig.set(name, value)

        assert says in rig.log[0]


def test_a_value_beyond_all_numbers_is_told(tmp_path: Path) -> None:
    path = tmp_path / "rig.fmu"
    model = with_causes("sensor-crosstalk", sizes={"sensor-crosstalk": 1.7e308})
    path.write_bytes(fmu(model, law_for(Model.load("ce152"))).content)

    with running(path, {"closed_loop": False, "u_c": 5.0}) as rig:
        with pytest.raises(FMICallException):
            rig.step(0.0, 1.0)

        assert "is not a number any longer" in rig.log[0]


def test_time_does_not_run_backwards(start: Start) -> None:
    with start() as rig, pytest.raises(FMICallException):
        rig.step(0.0, -T_S)
