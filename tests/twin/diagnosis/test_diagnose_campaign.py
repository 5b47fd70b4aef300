"""`diagnose` on short recorded campaigns: the truth within its interval, classes, silence, repeatability, the contract.

One campaign and one diagnosis per hidden effect; the tests look at different sides of them.  More effects are in the
fixed sample.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import board51
from protocol.campaign import load
from tests.harness.diagnose.agreement import disagreements
from tests.harness.diagnose.hidden_campaign import PlantName, make_campaign
from tests.twin.diagnosis.test_diagnose_bad_input import keep
from twin.diagnosis.judge.account import exceeds_floor
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.result import Diagnosis, to_json
from twin.model.parameters import Model

Hide = Any
# Recordings that are enough for one cause.
HALF = (
    "rest",
    *(f"step_{n}" for n in (1, 3, 5, 6)),
    "ramp",
    *(f"closed_loop_{n}" for n in (2, 4, 5, 6, 7, 8)),
)


@pytest.fixture(scope="module")
def hide(tmp_path_factory: pytest.TempPathFactory) -> Hide:
    """Record a short campaign with these effects, once; its folder."""

    @cache
    def record(
        effects: tuple[tuple[str, float], ...], seed: int, plant: PlantName, half: bool = False, outside: bool = False
    ) -> Path:
        folder = tmp_path_factory.mktemp("campaign")
        kind: dict[str, Mapping[str, float]] = {"effects": {}, "outside": dict(effects)}
        make_campaign(folder, **(kind if outside else {"effects": dict(effects)}), seed=seed, plant=plant, quick=True)
        if half:
            keep(folder, *HALF)
        return folder

    return record


@cache
def diagnosed(folder: Path, workers: int = 1) -> Diagnosis:
    result = diagnose(load(folder), Options(quick=True, workers=workers))
    assert not disagreements(to_json(result))
    return result


def class_of(result: Diagnosis) -> set[str]:
    """The first name and what the data cannot tell from it."""
    first = result.causes[0]
    return {first.name, *(member.name for member in first.indistinguishable_from)}


DRAG = ((("quadratic-drag", 1.0),), 104, "independent", True)
NO_EFFECTS = ((), 31, "independent", True)


@pytest.mark.parametrize(
    ("effects", "seed", "plant", "half"),
    [
        DRAG,
        pytest.param((("air-gap-offset", 1e-3),), 102, "emulator", False, marks=pytest.mark.slow),
    ],
)
def test_the_truth_is_named_and_within_its_interval(
    hide: Hide, effects: tuple[tuple[str, float], ...], seed: int, plant: PlantName, half: bool
) -> None:
    """The two rigs' own integration may shift a strength by a hundredth: that is added to the interval's half width."""
    ((name, strength),) = effects

    result = diagnosed(hide(effects, seed, plant, half))

    assert name in class_of(result)
    assert len(class_of(result)) <= 3
    first = result.causes[0]
    members = [first.parameters, *(member.parameters for member in first.indistinguishable_from)]
    names = [first.name, *(member.name for member in first.indistinguishable_from)]
    (value,) = [next(iter(sizes.values())) for sizes, whose in zip(members, names, strict=True) if whose == name]
    width = 0.5 * (value.ci95[1] - value.ci95[0]) if value.ci95 else 0.0
    assert value.value == pytest.approx(strength, abs=1.5 * width + 0.01 * abs(strength))
    assert result.gain is not None
    assert result.gain.removed > 0.9


@pytest.mark.slow
def test_where_nothing_is_hidden_the_model_is_adequate(hide: Hide) -> None:
    result = diagnosed(hide(*NO_EFFECTS))

    assert result.verdict == "model-adequate"
    assert result.causes == ()
    assert result.gain is not None
    assert result.gain.ci95_ratio == (1.0, 1.0)  # nothing was added


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "members"),
    [
        ((("amplifier-offset", -0.04),), {"amplifier-offset", "amplifier-dead-zone"}),
        ((("actuation-delay", 8e-4),), {"actuation-delay", "sampling-delay"}),
    ],
)
def test_what_the_data_cannot_tell_apart_is_one_class(
    hide: Hide, effects: tuple[tuple[str, float], ...], members: set[str]
) -> None:
    result = diagnosed(hide(effects, 41, "emulator"))

    assert members <= class_of(result)


@pytest.mark.slow
def test_an_effect_outside_the_catalogue_gets_no_false_name(hide: Hide) -> None:
    """Others are in the fixed sample; a wire spring is modelled in `remainder`."""
    result = diagnosed(hide((("sensor-sticks", 40e-6),), 51, "independent", outside=True))

    assert result.verdict == "unknown-cause"
    assert result.account.unexplained > 0.0 or exceeds_floor(result.gain)  # of those for fitting, or of the judges
    assert result.unexplained_where


def comparable(result: Diagnosis) -> dict[str, Any]:
    data = to_json(result)
    return {name: value for name, value in data.items() if name != "stages_s"}


@pytest.mark.slow
def test_the_number_of_workers_changes_nothing_and_neither_does_a_second_run(hide: Hide) -> None:
    folder = hide(*DRAG)

    serial, parallel = comparable(diagnosed(folder)), comparable(diagnosed(folder, workers=2))

    assert json.dumps(serial, sort_keys=True) == json.dumps(parallel, sort_keys=True)


def test_diagnosis_json_keeps_the_contract(hide: Hide) -> None:
    data = json.loads(json.dumps(to_json(diagnosed(hide(*DRAG))), allow_nan=False))

    assert data["verdict"] == "causes-found"
    (cause,) = data["causes"]
    assert cause["name"] == "quadratic-drag"
    assert 0.0 < cause["confidence"] <= 1.0
    assert isinstance(cause["indistinguishable_from"], list)
    assert cause["form"] is None  # the usual one
    assert 0.0 < cause["share_of_excess_explained"] <= 1.0
    assert list(cause["parameters"]) == ["c_n_s2_m2", "power"]
    parameter = cause["parameters"]["c_n_s2_m2"]
    assert parameter["ci95"][0] < parameter["value"] < parameter["ci95"][1]
    assert {"name", "why"} == set(data["not_testable"][0])
    assert {"share_of_excess", "where"} <= set(data["unexplained"])
    assert data["gain"]["horizon_samples"] == 10
    judge = data["gain"]["judge"]
    assert judge["extended_rmse_m"] < judge["baseline_rmse_m"]
    ratio = judge["extended_rmse_m"] / judge["baseline_rmse_m"]
    assert judge["ci95_ratio"][0] < ratio < judge["ci95_ratio"][1]
    assert data["calibrated"] is False


def test_the_extended_model_runs_in_predict_and_gives_the_stated_error(
    hide: Hide, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Same samples, same filter: per recording `predict` starts anew, as `gain` does, so the squares add up."""
    folder = hide(*DRAG)
    result = diagnosed(folder)
    path = tmp_path / "extended_model.json"
    path.write_text(json.dumps(result.extended.to_json(), allow_nan=False))
    assert Model.load(path).causes[0].name == "quadratic-drag"

    squares, count = 0.0, 0
    for number in (5, 6, 7, 8):
        recording = folder / f"closed_loop_{number}.csv.gz"
        assert board51.main(["predict", str(path), str(recording), "--campaign", str(folder), "--json"]) == 0
        summary = json.loads(capsys.readouterr().out)
        squares, count = squares + summary["count"] * summary["rmse_m"] ** 2, count + summary["count"]

    assert result.gain is not None
    assert count == pytest.approx(result.gain.count, rel=0.05)
    assert np.sqrt(squares / count) == pytest.approx(result.gain.extended_rmse_m, rel=0.02)


def supplied(model: Model, **change: float) -> Model:
    """The model with other numbers."""
    from dataclasses import replace

    parameters = dict(model.parameters)
    for name, factor in change.items():
        parameters[name] = replace(parameters[name], value=parameters[name].value * factor)
    return replace(model, parameters=parameters)


@pytest.mark.slow
def test_a_reference_model_is_the_baseline_as_it_is(hide: Hide) -> None:
    folder = hide(*NO_EFFECTS)
    right = diagnosed(folder)

    result = diagnose(load(folder), Options(model=supplied(right.baseline, K_c=1.1), quick=True, workers=1))

    assert result.verdict == "model-adequate"  # its form
    assert result.gain is not None
    assert right.gain is not None
    assert result.gain.baseline_rmse_m > 2.0 * right.gain.baseline_rmse_m
    assert result.gain.extended_rmse_m == pytest.approx(right.gain.extended_rmse_m, rel=1e-9)
    assert "K_c -9" in result.sentence
    assert "parameters of the reference model are wrong" in result.sentence
