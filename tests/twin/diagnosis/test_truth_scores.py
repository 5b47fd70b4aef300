"""Tests of the form of an answer to "name the cause", and of its score; worked by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.errors import DataError
from tests.harness.truth.answer import ALL, Answer, read_answer, write_answer
from tests.harness.truth.draw import NO_CAUSE, OTHER, PLACES, Truth, place_of
from tests.harness.truth.entries import probabilities_of, spread
from tests.harness.truth.flights import counted
from tests.harness.truth.residual import MEANS, Regression, Table, forward_bic
from tests.harness.truth.score import calibration_error, paired_interval, removed_share, score, table, unanswered

TRUTH = Truth(
    case="case-01",
    part="causes",
    seed=1,
    names=("quadratic-drag",),
    hidden={"quadratic-drag": 4.0},
    places=("force",),
    floor_m=3e-6,
)
NULL = replace(TRUTH, part="nulls", names=(NO_CAUSE,), hidden={}, places=())
UNKNOWN = replace(TRUTH, part="outside", names=(OTHER,), hidden={"wire-spring": 1e6})
ANSWER = Answer(
    verdict="cause",
    probabilities={"quadratic-drag": 0.7, "coulomb-friction": 0.2, OTHER: 0.1},
    place="force",
    names=("quadratic-drag", "coulomb-friction"),
    predictions="p.csv",
    seconds=2.0,
)


def test_an_answer_is_scored() -> None:
    right = score(TRUTH, ANSWER, base_m=13e-6, error_m=5e-6)

    assert (right.p_truth, right.is_top, right.false_alarm, right.false_name, right.place) == (
        0.7, True, None, False, True,
    )  # fmt: skip
    assert right.class_size == 2
    assert right.log_score == pytest.approx(math.log(0.7))
    assert right.removed == pytest.approx((169 - 25) / (169 - 9))


def test_several_truths_share_the_probability() -> None:
    both = replace(TRUTH, names=("quadratic-drag", "coulomb-friction"))

    assert score(both, ANSWER, base_m=1.0, error_m=1.0).p_truth == pytest.approx(0.9)


def test_a_name_where_nothing_or_something_unknown_is_hidden_is_false() -> None:
    alarm = score(NULL, ANSWER, base_m=3e-6, error_m=3e-6)
    unknown = score(UNKNOWN, replace(ANSWER, names=(OTHER,)), base_m=13e-6, error_m=14e-6)

    assert (alarm.false_alarm, alarm.false_name, alarm.place, alarm.removed) == (True, True, None, None)
    assert alarm.log_score == pytest.approx(math.log(1e-3))
    assert (unknown.false_alarm, unknown.false_name, unknown.p_truth) == (None, True, 0.1)
    assert unknown.removed is not None
    assert unknown.removed < 0.0


def test_nothing_is_removed_where_nothing_was_missing() -> None:
    assert removed_share(3.1e-6, 3e-6, 3e-6) is None
    assert removed_share(13e-6, 2e-6, 3e-6) == 1.0


def test_calibration_error_by_hand() -> None:
    scored = score(TRUTH, ANSWER, base_m=1.0, error_m=1.0)
    # Bin 0.6 to 0.8: 0.7 stated, half of them right. Bin 0.8 to 1: 0.9 stated, right.
    scores = [scored, replace(scored, is_top=False), replace(scored, top=0.9), replace(scored, top=1.0)]

    assert calibration_error(scores) == pytest.approx((2 * 0.2 + 2 * 0.05) / 4)


def test_paired_interval_is_of_the_differences() -> None:
    mean, low, high = paired_interval([0.0, 5.0, 9.0], [1.0, 6.0, 10.0])

    assert (mean, low, high) == pytest.approx((1.0, 1.0, 1.0))


def test_the_table_has_a_row_for_each_entry_and_counts_what_is_missing() -> None:
    scored = score(TRUTH, ANSWER, base_m=13e-6, error_m=5e-6)

    rows = table({"ours": [scored], "theirs": [unanswered(TRUTH, base_m=13e-6)]}).splitlines()

    assert rows[2].startswith("| ours | 0.70 | -0.36 |  | - | 0 of 1 | 1 of 1 | 2.0 | 0.30 | 90% | 2.0 |")
    assert rows[3].startswith("| theirs (1 unanswered) | 0.00 | -6.91 | -6.55 (-6.55 .. -6.55) | - | - | 0 of 1 |")


def good() -> dict[str, Any]:
    return {
        "verdict": "cause",
        "probabilities": {"core-saturation": 0.8, OTHER: 0.2},
        "place": "force",
        "class": ["core-saturation"],
        "predictions": "predictions.csv",
        "seconds": 1.5,
    }


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"verdict": "maybe"}, "verdict"),
        ({"probabilities": {"core-saturation": 0.8}}, "probabilities sum to 0.8"),
        ({"probabilities": {"gremlins": 1.0}}, "gremlins"),
        ({"probabilities": {"core-saturation": 1.5, OTHER: -0.5}}, "probabilities"),
        ({"place": "moon"}, "place"),
        ({"class": ["gremlins"]}, "gremlins"),
        ({"seconds": "fast"}, "seconds"),
        ({"note": "hello"}, "note"),
        ({"predictions": "absent.csv"}, "absent.csv"),
    ],
)
def test_what_is_wrong_in_an_answer_is_said(tmp_path: Path, change: dict[str, Any], problem: str) -> None:
    (tmp_path / "answer.json").write_text(json.dumps(good() | change), encoding="utf-8")
    (tmp_path / "predictions.csv").write_text("recording,t_s,x_m\n", encoding="utf-8")

    with pytest.raises(DataError, match=problem):
        read_answer(tmp_path)


@pytest.mark.parametrize("key", sorted(good()))
def test_each_of_the_six_keys_is_needed(tmp_path: Path, key: str) -> None:
    left = {name: value for name, value in good().items() if name != key}
    (tmp_path / "answer.json").write_text(json.dumps(left), encoding="utf-8")

    with pytest.raises(DataError, match=key):
        read_answer(tmp_path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("t,x\n", ":1 is not the header"),
        ("recording,t_s,x_m\na.csv,0.1,high\n", ":2"),
        ("recording,t_s,x_m\na,0,nan\n", ":2"),
    ],
)
def test_what_is_wrong_in_predictions_is_said(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "answer.json").write_text(json.dumps(good()), encoding="utf-8")
    (tmp_path / "predictions.csv").write_text(text, encoding="utf-8")

    with pytest.raises(DataError, match=problem):
        read_answer(tmp_path)


def test_a_written_answer_is_read_back(tmp_path: Path) -> None:
    weights = {"core-saturation": 3.0, NO_CAUSE: 1.0}
    write_answer(
        tmp_path, weights, verdict="cause", place="force", names=["core-saturation"],
        predicted={"a.csv": [(0.5, 2e-3)]}, seconds=1.0,
    )  # fmt: skip

    answer, predicted = read_answer(tmp_path)

    assert answer.probabilities == {"core-saturation": 0.75, NO_CAUSE: 0.25}
    assert predicted == {("a.csv", 5000): 2e-3}


def test_each_effect_has_a_place() -> None:
    assert place_of("current-sensor-offset") == "current"
    assert place_of("supply-hum") == "input"
    assert {place_of(name) for name in ALL[:-2]} == set(PLACES)


def test_rows_count_after_a_quarter_of_a_second_off_the_stops_and_without_a_gap() -> None:
    t = np.delete(2e-3 * np.arange(400), 300)
    x = np.full(399, 3e-3)
    x[10] = 0.0

    rows = np.flatnonzero(counted(t, x, 5.7e-3))

    assert rows[0] == 10 + 125
    assert set(range(135, 399)) - set(rows.tolist()) == set(range(300, 315))


def test_a_diagnosis_becomes_probabilities() -> None:
    cause = {
        "name": "core-saturation",
        "confidence": 0.9,
        "alternatives": [{"name": "force-exponent", "log_likelihood_lead": -math.log(2.0), "stated": False}],
    }

    explained = probabilities_of({"verdict": "causes-found", "causes": [cause]})
    doubted = probabilities_of({"verdict": "unknown-cause", "causes": [], "candidates": [cause | {"confidence": 0.2}]})
    adequate = probabilities_of({"verdict": "model-adequate", "causes": []})

    assert explained["core-saturation"] == pytest.approx(0.6 + 0.1 / len(ALL))
    assert explained["force-exponent"] == pytest.approx(0.3 + 0.1 / len(ALL))
    assert doubted[OTHER] == pytest.approx(0.8)
    assert adequate[NO_CAUSE] == pytest.approx(0.95 + 0.05 / len(ALL))
    for probabilities in (explained, doubted, adequate):
        assert math.fsum(probabilities.values()) == pytest.approx(1.0)


def test_forward_selection_finds_the_term_and_only_that() -> None:
    rng = np.random.default_rng(5)
    features = rng.standard_normal((4000, 6)) * (1e-3, 0.1, 0.05, 0.5, 0.1, 0.01)
    v = features[:, 2] / 0.05
    residuals = rng.standard_normal((4000, 2)) * (1e-5, 1e-3)
    residuals[:, 0] += 3e-5 * v * np.abs(v)
    table = Table(keys=[], x_hat=np.zeros(4000), residuals=residuals, features=features)

    regression = forward_bic(table, table)

    assert [(channel, term) for channel, term, _ in regression.terms] == [("x", "v|v|")]
    assert spread(regression)["quadratic-drag"] > 0.8
    assert spread(Regression(correction=np.zeros(0), terms=[]))[NO_CAUSE] > 0.8
    left = residuals[:, 0] - regression.correction * residuals[:, 0].std()
    assert left.std() == pytest.approx(1e-5, rel=0.05)


def test_terms_stand_for_names_of_the_list() -> None:
    assert set(MEANS.values()) <= set(ALL)
