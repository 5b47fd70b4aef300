"""Tests of the parts of diagnosis.json that programs other than the twin read."""

from __future__ import annotations

from typing import Any

import pytest

from protocol.diagnosis import read_diagnosis
from protocol.errors import DataError

CAUSE: dict[str, Any] = {
    "name": "air-gap-offset",
    "confidence": 0.9,
    "indistinguishable_from": ["force-exponent", "position-sensor-gain"],
    "next_experiment": {
        "separation_z_now": {"force-exponent": 1.5, "position-sensor-gain": None},
        "experiments": [{"name": "holds", "separation_z": {"force-exponent": 12.0, "position-sensor-gain": None}}],
        "not_separable_here": ["Measure the gap."],
    },
}
VALID: dict[str, Any] = {"verdict": "causes-found", "sentence": "It is so.", "causes": [CAUSE], "candidates": []}


def test_a_class_comes_with_its_separations_and_what_nothing_is_known_of_as_none() -> None:
    answer = read_diagnosis(VALID, where="x")

    (suspect,) = answer.suspects
    assert answer.is_open
    assert suspect.confounders == {"force-exponent": 1.5, "position-sensor-gain": 0.0}
    assert suspect.experiments == {"holds": {"force-exponent": 12.0, "position-sensor-gain": 0.0}}
    assert suspect.outside == ("Measure the gap.",)


def test_a_stated_value_is_no_confounder_but_something_to_measure() -> None:
    clock = {"name": "stated-clock", "stated": True, "sentence": "the clock is 2 % slow", "confirm": "compare it"}
    alternatives = [{"name": "force-exponent", "stated": False}, clock]
    names = ["force-exponent", "stated-clock"]
    cause = CAUSE | {"indistinguishable_from": names, "alternatives": alternatives}

    (suspect,) = read_diagnosis(VALID | {"causes": [cause]}, where="x").suspects

    assert suspect.confounders == {"force-exponent": 1.5}
    assert suspect.outside == ("Measure the gap.", "the clock is 2 % slow? compare it")


def test_where_no_cause_holds_the_candidates_are_looked_at() -> None:
    answer = read_diagnosis(VALID | {"verdict": "unknown-cause", "causes": [], "candidates": [CAUSE]}, where="x")

    assert [suspect.name for suspect in answer.suspects] == ["air-gap-offset"]


def test_a_cause_without_a_class_is_not_open() -> None:
    distinct = CAUSE | {"indistinguishable_from": [], "next_experiment": None}

    assert not read_diagnosis(VALID | {"causes": [distinct]}, where="x").is_open


@pytest.mark.parametrize(
    "wrong",
    [{}, {"verdict": "x"}, VALID | {"causes": [1]}, VALID | {"causes": [{"name": "x"}]}, VALID | {"causes": {"a": 1}}],
)
def test_what_is_no_answer_is_named(wrong: dict[str, Any]) -> None:
    with pytest.raises(DataError, match=r"^here is not a diagnosis.json of board51 diagnose"):
        read_diagnosis(wrong, where="here")


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
@pytest.mark.parametrize("key", ["confidence", "horizon_s", "floor_m", "value", "low"])
def test_a_number_that_is_not_finite_is_named(key: str, number: float) -> None:
    interval = {"value": 1e-3, "low": 5e-4, "high": 2e-3}
    ahead = {"horizon_s": 0.1, "floor_m": 1e-5, "baseline": interval, "extended": interval | {key: number}}
    wrong = VALID | {
        "causes": [CAUSE | ({key: number} if key == "confidence" else {})],
        "show": {"judged": True, "ahead": [ahead | {key: number}]},
    }

    with pytest.raises(DataError, match=f"{key} = {number}"):
        read_diagnosis(wrong, where="here")
