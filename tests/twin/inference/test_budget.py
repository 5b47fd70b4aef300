"""A diagnosis computes no more than its budget, says what it did not examine, and claims nothing about that."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from board51 import main
from protocol.campaign import load
from tests.harness.diagnose.foreign import hall_campaign
from tests.harness.diagnose.known_diagnosis import QUIET, steps
from tests.harness.diagnose.simulated_rig import PLANT, THETA, TICK_S, narrow, strong
from tests.twin.diagnosis.test_diagnose_campaign import comparable
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose, shortened
from twin.diagnosis.result import Diagnosis
from twin.diagnosis.search.periodic import AMPLITUDE, CAUSE, FREQUENCY
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stepwise import select
from twin.diagnosis.search.task import Search
from twin.estimation.pace import Reuse, pace_of
from twin.evidence.gather import gather
from twin.inference.budget import MILLION, Budget, Spent
from twin.inference.fisher_scoring import climb, narrowing
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, Theta
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings

SHORT = 3.0 * MILLION  # the rounds of the small foreign campaign take more
LAG, FORCE = "position-sensor-lag", "constant-force"


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hall_campaign(tmp_path_factory.mktemp("foreign"), intervals_ms=(2, 5), samples=1500)


def test_a_refused_run_closes_the_budget_until_it_is_opened_again() -> None:
    budget = Budget(100.0, reserved=0.2)

    budget.take(70.0)
    with pytest.raises(Spent):
        budget.take(11.0)
    with pytest.raises(Spent):
        budget.take(1.0)
    budget.reopen()
    budget.take(30.0)

    assert budget.spent == 100.0


def test_the_whole_question_is_unanswered_not_its_parts() -> None:
    budget = Budget(0.0)

    with suppress(Spent), budget.question("whether the ball is green"), budget.question("the colour of light"):
        budget.take(1.0)

    assert budget.unanswered == ["whether the ball is green"]


@pytest.mark.parametrize("workers", [1, 2])
def test_work_side_by_side_gets_equal_shares_whoever_is_first(workers: int) -> None:
    """Four runs each of three climbers: the budget pays for ten, the shares for three each."""
    evidence = gather(narrow(THETA, seconds=2.0), PLANT)
    run = pace_of(evidence.series).steps(THETA.base(PLANT), THETA.vector(), Reuse.NONE)
    budget = Budget(10.5 * run)
    criterion = Criterion(evidence, PLANT, TICK_S, workers=workers, budget=budget)

    def four(theta: Theta) -> None:
        for _ in range(4):
            criterion.value(theta)

    with pytest.raises(Spent):
        criterion.each(four, [THETA, THETA, THETA])
    criterion.close()

    assert budget.spent == 9.0 * run
    assert budget.closed


@pytest.fixture(scope="module")
def unfinished(foreign: Path) -> Diagnosis:
    return diagnose(load(foreign), Options(quick=True, workers=1, budget=SHORT))


def test_a_foreign_campaign_ends_by_its_budget_and_says_what_was_not_examined(unfinished: Diagnosis) -> None:
    diagnosis = unfinished

    assert diagnosis.verdict == "unfinished"
    assert diagnosis.budget.spent <= SHORT
    assert diagnosis.budget.unanswered
    assert diagnosis.ruled_out == ()
    assert "budget of 3 million filter steps" in diagnosis.sentence
    for question in diagnosis.budget.unanswered:
        assert question in diagnosis.sentence


def test_the_answer_at_the_end_of_a_budget_does_not_depend_on_the_number_of_workers(
    foreign: Path, unfinished: Diagnosis
) -> None:
    two = diagnose(load(foreign), Options(quick=True, workers=2, budget=SHORT))

    assert json.dumps(comparable(unfinished), sort_keys=True) == json.dumps(comparable(two), sort_keys=True)


@pytest.mark.slow
def test_quick_has_a_budget_without_being_asked_and_a_sufficient_one_changes_nothing(foreign: Path) -> None:
    diagnosis = diagnose(load(foreign), Options(quick=True))
    free = diagnose(load(foreign), Options(quick=True, budget=math.inf))

    assert diagnosis.budget.limit == settings.BUDGET_QUICK
    assert diagnosis.verdict != "unfinished"
    assert diagnosis.budget.unanswered == []
    assert without_budget(comparable(diagnosis)) == without_budget(comparable(free))


def without_budget(data: dict[str, Any]) -> str:
    return json.dumps({name: value for name, value in data.items() if name != "budget"}, sort_keys=True)


def test_the_command_line_says_that_the_search_ended_by_its_budget(
    foreign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["diagnose", str(foreign), "--quick", "--budget", "3", "--out", str(tmp_path)])

    output = capsys.readouterr()
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert code == 1
    assert data["verdict"] == "unfinished"
    assert data["budget"]["filter_steps"] == SHORT
    assert data["budget"]["spent"] <= SHORT
    assert "the search used up its budget" in output.out
    assert "3 candidates" in output.out
    assert " %  " in output.err  # progress
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "The budget of 3 million filter steps ended first" in report


@pytest.mark.parametrize(("supplied", "text"), [("0.3", "does not fit even the paper's model"), ("0", "--budget is 0")])
def test_a_budget_that_is_none_is_refused(
    foreign: Path, supplied: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(foreign), "--quick", "--quiet", "--budget", supplied]) == 2

    output = capsys.readouterr()
    assert text in output.err
    assert output.out == ""


def test_of_very_many_flights_quick_takes_less_of_each() -> None:
    """The budget of `--quick` pays for a search over so many samples."""
    (flight,) = [record for record in narrow(THETA, seconds=5.0) if record.kind == "closed-loop"]
    handful, many = [flight] * 3, [flight] * 100

    assert {len(record.t) for record in shortened(handful)[0]} == {settings.QUICK_FLIGHT_SAMPLES}
    assert sum(len(record.t) for record in shortened(many)[0]) == settings.QUICK_SAMPLES
    assert "400 samples of 100 recordings" in shortened(many)[1]


@pytest.fixture(scope="module")
def lagging() -> Iterator[tuple[Criterion, Selection]]:
    """A rig whose sensor lags and that is shaken, and the search of it to its end; its budget knows what that took."""
    rig = strong(LAG, 1e-3, strong(CAUSE.name, 3e-3, QUIET)).having(FREQUENCY, 7.0)
    records = [steps(rig, seed=seed, seconds=8.0) for seed in (3, 4)]
    criterion = Criterion(gather(records, PLANT), PLANT, TICK_S, workers=2)
    yield criterion, searched(criterion)
    criterion.close()


def searched(criterion: Criterion) -> Selection:
    with criterion.free():
        base = climb(criterion, QUIET, BASE)
        floor = floor_of(criterion, base.theta)
    candidates = tuple(BY_NAME[name] for name in (CAUSE.name, LAG, FORCE))
    return select(Search(criterion=criterion, floor=floor, candidates=candidates, max_candidates=3), base)


@pytest.mark.slow
@pytest.mark.sample
def test_wherever_a_budget_ends_what_is_known_by_then_is_sound(lagging: tuple[Criterion, Selection]) -> None:
    """Phases and numbers belong to each other, no class is told that was not looked for, the bound holds."""
    criterion, whole = lagging
    needed = criterion.whole.spent
    assert set(whole.causes) == {CAUSE.name, LAG}
    assert criterion.whole.unanswered == []
    outcomes = set()
    for share in (0.02, 0.2, 0.35, 0.65, 0.95):
        budget = Budget(share * needed)
        criterion.whole = budget

        selection = searched(criterion)

        assert budget.spent <= budget.limit
        assert budget.unanswered
        find_classes = " ".join(question for question in budget.unanswered if "explain as much" in question)
        assert all(cause in find_classes for cause in selection.causes if cause not in selection.classes)
        assert set(selection.gains) == set(selection.causes)
        with criterion.free():
            shapes = narrowing(selection.fit.free, selection.fit.covariance)
            assert criterion.value(selection.fit.theta) + shapes == pytest.approx(selection.fit.loglik, rel=1e-12)
        assert (AMPLITUDE in selection.fit.free) == (CAUSE.name in selection.causes)
        outcomes.add(tuple(selection.causes))
    assert len(outcomes) > 2  # it did end in different places
