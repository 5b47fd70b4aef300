"""Tests of the choice of the written model: it never predicts the judge recordings worse than the reference."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.harness.diagnose.agreement import disagreements
from tests.harness.diagnose.known_diagnosis import QUIET, campaign, fit_of, steps
from tests.harness.diagnose.simulated_rig import controller, strong
from twin.api.results import Diagnosed
from twin.diagnosis.judge.choice import Choice, candidates_of, choice_without_judges, choose, worse
from twin.diagnosis.judge.prediction_gain import Gain
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose_records
from twin.diagnosis.residuals.summary import summarise
from twin.diagnosis.search.state import Selection
from twin.inference.theta import Theta
from twin.model.parameters import Model

DRAG, OTHER = strong("quadratic-drag", 1.0, QUIET), strong("coulomb-friction", 1e-3, QUIET)
BOTH = strong("coulomb-friction", 1e-3, DRAG)


def ahead(ratio: float, *, spread: float = 0.05, ms: int = 20) -> Gain:
    """The error of a model over that of the reference, 85 um."""
    return Gain(
        samples=ms // 2,
        horizon_s=1e-3 * ms,
        baseline_rmse_m=85e-6,
        extended_rmse_m=ratio * 85e-6,
        floor_m=6e-6,
        ci95_ratio=(ratio - spread, ratio + spread),
        ci95_floor=(2.0, 20.0),
        count=10_000,
    )


def searched() -> Selection:
    """A search that took drag, then friction."""
    base, drag, both = fit_of(QUIET, 0.0), fit_of(DRAG, 100.0), fit_of(BOTH, 140.0)
    return Selection(base=base, fit=both, causes=("quadratic-drag", "coulomb-friction")).with_fits([drag, both])


def chosen(gains: Mapping[int, list[Gain]], *, sure: bool = False) -> Choice:
    """Return the choice that is made if the model with each number of causes has these gains."""

    def measure(theta: Theta) -> list[Gain]:
        return gains[len({name.partition(".")[0] for name, _ in theta.causes})]

    selection = searched()
    return choose(candidates_of(selection, has_model=False), selection.base, measure, sure=sure)


@pytest.mark.parametrize("sure", [False, True])
def test_a_model_that_is_worse_on_the_judges_is_not_written(sure: bool) -> None:
    choice = chosen({2: [ahead(132 / 85)], 1: [ahead(1.3)]}, sure=sure)

    assert choice.kind == "reference"
    assert choice.fit is searched().base or choice.fit is not None
    assert choice.fit is not None
    assert not choice.fit.theta.causes
    assert [refusal.worse for refusal in choice.refused] == [True, True]


def test_the_last_model_of_the_search_that_is_better_is_written_instead() -> None:
    choice = chosen({2: [ahead(1.5)], 1: [ahead(0.6)]})

    assert choice.kind == "fewer-causes"
    assert choice.fit is not None
    assert {name for name, _ in choice.fit.theta.causes} == {name for name, _ in DRAG.causes}
    assert choice.gains == (ahead(0.6),)


def test_harm_at_another_horizon_counts() -> None:
    choice = chosen({2: [ahead(0.9), ahead(1.2, ms=40)], 1: [ahead(0.95, spread=0.02), ahead(0.9, ms=40)]}, sure=True)

    assert choice.kind == "fewer-causes"
    assert choice.refused[0].gain == ahead(1.2, ms=40)


def test_candidates_must_surely_predict_better_and_names_that_hold_need_not() -> None:
    as_good = {2: [ahead(0.99)], 1: [ahead(0.99)]}

    assert chosen(as_good).kind == "reference"
    assert chosen(as_good, sure=True).kind == "all-causes"


def test_an_error_that_is_surely_larger_is_worse_however_little() -> None:
    assert worse([ahead(1.01, spread=0.005)])
    assert chosen({2: [ahead(1.01, spread=0.005)], 1: [ahead(1.0)]}, sure=True).kind == "reference"
    assert not worse([ahead(1.01, spread=0.02)])


@pytest.mark.parametrize(("floor_m", "is_worse"), [(88e-6, False), (80e-6, True), (math.nan, True)])
def test_an_error_that_is_noise_alone_is_not_worse(floor_m: float, is_worse: bool) -> None:
    at_40_ms = replace(ahead(1.035, spread=0.01, ms=40), floor_m=floor_m)

    assert (worse([ahead(1.01), at_40_ms]) is not None) == is_worse


def test_without_a_judge_the_model_is_marked() -> None:
    choice = choice_without_judges(searched(), has_model=False)

    assert (choice.kind, choice.compared) == ("all-causes", False)


@pytest.fixture(scope="module")
def harmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A diagnosis of flights with dry friction, judged by flights without, of a rig whose plant nobody stated."""
    rubbing = strong("coulomb-friction", 3e-3, QUIET)
    rig_campaign = campaign()
    rig_campaign = replace(rig_campaign, plant=replace(rig_campaign.plant, assumed=True))
    records, judges = [steps(rubbing, seed=1, seconds=5.0)], [steps(QUIET, seed=3, use="judge", seconds=5.0)]
    diagnosis = diagnose_records(rig_campaign, records, judges, Options(quick=True, workers=1))
    result = Diagnosed(
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        causes=tuple(cause.name for cause in diagnosis.causes),
        extended=diagnosis.extended,
        warnings=diagnosis.warnings,
        details=diagnosis,
        residuals=summarise(diagnosis, controller(), quick=True),
        where="runs/monday",
    )
    folder = tmp_path_factory.mktemp("harmed")
    result.save(folder)
    assert not result.offered
    return folder


def diagnosis_json(folder: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    return data


@pytest.mark.slow
def test_causes_of_other_flights_are_no_model_for_these(harmed: Path) -> None:
    data = diagnosis_json(harmed)

    model = Model.load(harmed / "extended_model.json")
    (refused, *_) = data["extended_model"]["refused"]
    assert refused["why"] == "worse"
    assert refused["judge"]["extended_rmse_m"] > refused["judge"]["baseline_rmse_m"]
    assert not model.causes
    assert model.provenance["extends"] == "reference"
    assert data["extended_model"]["is"] == "reference"
    assert not data["extended_model"]["offered"]


@pytest.mark.slow
def test_one_file_agrees_with_itself_where_a_model_was_refused(harmed: Path) -> None:
    data = diagnosis_json(harmed)

    assert disagreements(data) == []
    assert data["verdict"] == "unknown-cause"
    assert data["gain"]["judge"]["extended_rmse_m"] == data["gain"]["judge"]["baseline_rmse_m"]
    assert "extended_model.json is the reference itself" in data["sentence"]


@pytest.mark.slow
def test_an_assumed_plant_is_said_in_model_answer_and_report(harmed: Path) -> None:
    data, page = diagnosis_json(harmed), (harmed / "report.html").read_text(encoding="utf-8")
    model = Model.load(harmed / "extended_model.json")
    ball = "for an assumed ball of 8.28 g and travel of 5.7 mm"

    assert data["plant_assumed"]
    assert model.plant.assumed
    assert ball in model.parameters["K_c"].method
    assert ball not in model.parameters["K_A"].method
    assert all(ball in cause["sentence"] for cause in data["candidates"] if cause["name"] == "coulomb-friction")
    assert any(ball in warning and "[plant]" in warning for warning in data["warnings"])
    assert page.count(ball) >= 3
