"""Tests of which answers count as right, and of the rates.  A run that was stopped goes on."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from protocol.errors import DataError, UsageError
from tests.bench.diagnosis import play
from tests.bench.diagnosis import run as run_bench
from tests.harness.diagnose.scoring import Answer, Judgement, Named, Outcome, judge, read_answer, removed_share
from tests.harness.diagnose.tally import Rate, confusion, page, rates, reliability, removed_median, wilson

# The example of design.md.
DIAGNOSIS: dict[str, Any] = {
    "verdict": "causes-found",
    "causes": [
        {
            "name": "air-gap-offset",
            "parameters": {"d_m": {"value": 0.0024, "ci95": [0.0022, 0.0026]}},
            "confidence": 0.98,
            "indistinguishable_from": ["position-sensor-offset"],
            "share_of_excess_explained": 0.93,
            "next_experiment": {"what": "...", "separation_z": 30.0},
        }
    ],
    "not_testable": [{"name": "current-sensor-gain", "why": "absorbed by K_A and K_c"}],
    "unexplained": {"share_of_excess": 0.02, "where": "..."},
    "gain": {
        "horizon_samples": 10,
        "judge": {
            "baseline_rmse_m": 1.2e-4,
            "extended_rmse_m": 1.5e-5,
            "ci95_ratio": [0.10, 0.14],
            "noise_floor_m": 1.3e-5,
        },
    },
}
ANSWER = read_answer(DIAGNOSIS)


def named(*names: str, verdict: str = "causes-found", similar: tuple[str, ...] = ()) -> Answer:
    return Answer(verdict=verdict, causes=tuple(Named(name=n, members=(n, *similar), confidence=0.9) for n in names))


def outcome(part: str, truths: tuple[str, ...], answer: Answer, *, seed: int = 0, grade: str = "strong") -> Outcome:
    return Outcome(
        part=part,
        seed=seed,
        program="p",
        quick=False,
        plant="emulator",
        grade=grade if part == "causes" else "",
        truths=truths,
        strengths=(1.0,) * len(truths),
        status="answered",
        verdict=answer.verdict,
        named=tuple(cause.name for cause in answer.causes),
        diagnose_s=30.0,
        judgement=judge(part, truths, answer),
    )


def test_the_first_name_or_a_member_of_its_class_is_right() -> None:
    first = judge("causes", ["air-gap-offset"], ANSWER)
    member = judge("causes", ["position-sensor-offset"], ANSWER)
    other = judge("causes", ["quadratic-drag"], ANSWER)

    assert (first.right, first.first, first.column) == (True, True, "air-gap-offset")
    assert (member.right, member.first, member.column) == (True, False, "position-sensor-offset")
    assert (other.right, other.first, other.column, other.false_names) == (False, False, "air-gap-offset", 1)
    assert first.confidence == 0.98


def test_a_class_of_four_does_not_count() -> None:
    wide = named("a", similar=("b", "c", "d"))

    assert judge("causes", ["a"], wide).right is True
    assert judge("causes", ["b"], wide).right is False
    assert judge("causes", ["b"], named("a", similar=("b", "c"))).right is True


def test_the_second_name_is_not_right_for_a_single_cause() -> None:
    assert judge("causes", ["b"], named("a", "b")).right is False


def test_a_cause_said_to_be_not_testable_is_counted_by_itself() -> None:
    silent = replace(ANSWER, verdict="model-adequate", causes=())

    judgement = judge("causes", ["current-sensor-gain"], silent)

    assert judgement.right is None
    assert judgement.column == "not-testable"
    assert judge("causes", ["motional-emf"], silent).right is False


def test_a_composite_is_right_by_its_share() -> None:
    judgement = judge("composites", ["a", "b", "x"], named("b", "a", "z"))

    assert (judgement.hits, judgement.truths, judgement.false_names, judgement.right) == (2, 3, 1, False)
    assert judge("composites", ["a", "b"], named("b", "a")).right is True


def test_nothing_hidden_wants_an_adequate_model() -> None:
    assert judge("nulls", [], Answer(verdict="model-adequate")).right is True
    assert judge("nulls", [], Answer(verdict="unknown-cause")).right is False
    assert judge("nulls", [], ANSWER).right is False


def test_outside_the_catalogue_the_reserve_counts_not_the_names() -> None:
    assert judge("outside", ["wire-spring"], named("force-exponent", verdict="unknown-cause")).right is True
    assert judge("outside", ["wire-spring"], named("force-exponent")).right is False
    assert judge("outside", ["wire-spring"], Answer(verdict="model-adequate")).right is False
    lenient = judge("outside", ["bit-errors"], Answer(verdict="model-adequate"), may_be_adequate=True)
    assert lenient.right is True


def test_the_share_removed_is_of_the_error_above_the_floor() -> None:
    assert removed_share(ANSWER) == pytest.approx((120 - 15) / (120 - 13))
    assert removed_share(replace(ANSWER, baseline_rmse_m=1.33e-5)) is None
    assert removed_share(replace(ANSWER, extended_rmse_m=1.2e-5)) == 1.0
    assert removed_share(read_answer({"verdict": "model-adequate"})) is None


def test_an_answer_without_causes_or_gain_is_read() -> None:
    answer = read_answer({"verdict": "model-adequate", "causes": [], "gain": None})

    assert answer.causes == ()
    assert math.isnan(answer.baseline_rmse_m)


def test_wilson_is_the_interval_of_the_book() -> None:
    # Wilson 1927 through Newcombe 1998 (Stat. Med. 17), table I: 81/263, 15/148, 0/20, 1/29 at 95 %.
    for hits, count, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)):
        assert wilson(hits, count) == pytest.approx((low, high), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_rates_matrix_and_reliability_count_what_they_say() -> None:
    silent = replace(ANSWER, verdict="model-adequate", causes=())
    outcomes = [
        replace(outcome("causes", ("air-gap-offset",), ANSWER), minor_effects=(("motional-emf", 12.0),)),
        outcome("causes", ("quadratic-drag",), ANSWER),
        outcome("causes", ("current-sensor-gain",), silent),
        outcome("causes", ("motional-emf",), silent, grade="medium"),
        outcome("nulls", (), silent),
        outcome("nulls", (), ANSWER),
        outcome("outside", ("wire-spring",), named("force-exponent", verdict="unknown-cause")),
        outcome("outside", ("wire-spring",), named("force-exponent")),
        outcome("outside", ("magnetic-hysteresis",), named("magnetic-hysteresis")),  # learnt: the name is right
        replace(outcome("composites", ("a", "b"), named("a", "c")), minor_effects=(("b", 30.0), ("d", 11.0))),
        replace(outcome("composites", ("a", "b"), ANSWER), status="grounded", judgement=None),
    ]

    counts = {rate.name: (rate.hits, rate.count) for rate in rates(outcomes)}
    right, name_counts = confusion(outcomes)["quadratic-drag"]
    ((mean, _, bin_rate),) = reliability(outcomes)
    share, count = removed_median(outcomes)

    assert counts == {
        "strong: right (first, or in a class of at most 3)": (1, 2),
        "strong: first": (1, 2),
        "medium: right (first, or in a class of at most 3)": (0, 1),
        "medium: first": (0, 1),
        "one cause, right: a false name besides": (0, 1),
        "one cause, right: unknown-cause all the same": (0, 1),
        "one cause, right: another listed as too small to be named": (1, 1),
        "nothing hidden: false alarm": (1, 2),
        "outside: honest": (2, 3),
        "outside: false name": (1, 3),
        "outside: honest, with confounders listed": (1, 3),
        "outside: not noticed": (0, 3),
        "several causes: listed as too small, and there": (1, 2),
        "2 causes: truths found": (1, 2),
        "2 causes: all found": (0, 1),
        "campaigns without an answer": (1, 11),
    }
    assert (right, dict(name_counts)) == (0, {"air-gap-offset": 1})
    assert confusion(outcomes)["wire-spring"] == (1, {"unknown-cause": 1, "force-exponent": 1})
    assert mean == pytest.approx(0.98)
    assert (bin_rate.hits, bin_rate.count) == (1, 2)
    assert share == pytest.approx(105 / 107)
    assert count == 1
    text = page(outcomes)
    assert "| strong: first | 1 of 2 | 50 % |" in text
    assert "| none | 1 of 2 | model-adequate 1, air-gap-offset 1 |" in text


def test_an_empty_rate_has_no_value() -> None:
    assert math.isnan(Rate(name="", hits=0, count=0).value)
    assert rates([]) == []
    assert "nan" not in page([])


def test_results_of_this_program_are_not_run_again(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    outcomes = [outcome("nulls", (), Answer(verdict="model-adequate"), seed=seed) for seed in (0, 1)]
    lines = [json.dumps(entry.to_json()) for entry in outcomes]
    results.write_text("\n".join([*lines, lines[0][:40]]), encoding="utf-8")  # the last one was cut off

    again = play([("nulls", 1), ("nulls", 0)], program="p", results=results)

    assert again == [outcomes[1], outcomes[0]]
    assert isinstance(again[0].judgement, Judgement)


def test_bad_options_are_one_error() -> None:
    with pytest.raises(UsageError, match="no part 'all'"):
        run_bench(part="all")
    with pytest.raises(UsageError, match="negative"):
        run_bench(runs=-1)


def test_a_file_that_holds_no_results_is_said(tmp_path: Path) -> None:
    other = tmp_path / "other.jsonl"
    other.write_text('{"name": "no outcome"}\n', encoding="utf-8")

    with pytest.raises(DataError, match="not a file of results"):
        play([], program="p", results=other)


def test_a_limit_that_nothing_reached_is_no_miss_and_a_false_name_still_is() -> None:
    silent = judge("causes", ["current-limit"], Answer(verdict="model-adequate"), in_the_data=False)
    wrong = judge("causes", ["current-limit"], ANSWER, in_the_data=False)

    assert (silent.right, silent.column) == (None, "not-in-the-data")
    assert wrong.right is False
    assert judge("causes", ["current-limit"], Answer(verdict="model-adequate")).right is False
