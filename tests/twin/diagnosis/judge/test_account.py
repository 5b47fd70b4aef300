"""Shares, rest, verdict, confidence and sentence rest on one account, and a check finds them at odds."""

from __future__ import annotations

import copy
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.harness.diagnose.agreement import disagreements
from tests.harness.diagnose.known_diagnosis import QUIET, diagnosis, fit_of
from tests.harness.diagnose.simulated_rig import controller
from twin.diagnosis.judge.account import account_of, verdict_of
from twin.diagnosis.judge.judgement import judge
from twin.diagnosis.judge.prediction_gain import Gain, bootstrap
from twin.diagnosis.report.page import to_html
from twin.diagnosis.report.sentences import beyond_sentence, summary_sentence
from twin.diagnosis.residuals.summary import summarise
from twin.diagnosis.result import Diagnosis, to_json
from twin.diagnosis.search.state import Selection
from twin.estimation.prediction_floor import TOLERANCE
from twin.settings import diagnosis as settings

pytestmark = pytest.mark.xdist_group("diagnosis-account")  # what several tests look at is made once


def searched(explained: float, **gains: float) -> Selection:
    """A search whose model explains so much, with what is lost without each cause."""
    return Selection(
        base=fit_of(QUIET, 0.0),
        fit=fit_of(QUIET, explained),
        causes=tuple(gains),
        gains={name: gains[name] for name in gains},
    )


def gain_between(low: float, high: float, *, baseline_m: float = 1e-4) -> Gain:
    """Errors between so many times the floor."""
    ratio = 0.5 * (low + high)
    return Gain(
        samples=10,
        horizon_s=0.02,
        baseline_rmse_m=baseline_m,
        extended_rmse_m=ratio * 1e-5,
        floor_m=1e-5,
        ci95_ratio=(0.1 * low, 0.1 * high),
        ci95_floor=(low, high),
        count=10_000,
    )


@pytest.mark.parametrize(
    ("explained", "gains", "lacks", "fits"),
    [
        (720.0, {"a": 720.0}, 280.0, True),  # nothing measurable is left: the cause explains all of it
        (720.0, {"a": 720.0}, 280.0, False),
        (900.0, {"a": 500.0, "b": 100.0}, 100.0, False),  # 300 jointly
        (900.0, {"a": 850.0, "b": 880.0}, 100.0, False),  # each hides the other
        (900.0, {"a": 850.0, "b": 880.0}, -50.0, True),
        (0.0, {}, 400.0, False),
    ],
)
def test_what_causes_explain_alone_and_jointly_and_what_is_left_is_all_there_is(
    explained: float, gains: dict[str, float], lacks: float, fits: bool
) -> None:
    account = account_of(searched(explained, **gains), lacks, fits)

    parts = [*account.cause_shares.values(), account.jointly, account.unexplained]
    assert all(0.0 <= part <= 1.0 for part in parts)
    assert sum(parts) == pytest.approx(1.0)
    assert (account.unexplained == 0.0) is fits
    if not fits:
        assert account.unexplained == pytest.approx(lacks / (explained + lacks))


def test_a_part_that_two_causes_take_jointly_is_neither_s() -> None:
    account = account_of(searched(900.0, a=500.0, b=100.0), 100.0, False)

    assert account.cause_shares == pytest.approx({"a": 0.5, "b": 0.1})
    assert account.jointly == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("named", "fits", "low", "verdict"),
    [
        (True, True, 0.98, "causes-found"),
        (True, True, 1.15, "partly-explained"),
        (True, True, 2.2, "partly-explained"),  # more is left than noise makes, and most of the error is explained
        (True, False, 0.98, "unknown-cause"),
        (True, False, 1.15, "unknown-cause"),
        (False, True, 0.98, "model-adequate"),
        (False, True, 1.15, "unknown-cause"),
        (False, False, 0.98, "unknown-cause"),
        (True, True, float("nan"), "causes-found"),
    ],
)
def test_the_verdict_is_what_both_kinds_of_recordings_say(named: bool, fits: bool, low: float, verdict: str) -> None:
    assert verdict_of(named=named, is_adequate=fits, leading=fits, gain=gain_between(low, low + 0.1)) == verdict
    assert verdict_of(named=named, is_adequate=fits, gain=None) in ("causes-found", "model-adequate", "unknown-cause")


def test_beside_a_rest_a_name_holds_that_explains_more_than_the_rest() -> None:
    gain = gain_between(1.15, 1.25)
    assert verdict_of(named=True, is_adequate=False, leading=True, gain=gain) == "partly-explained"
    assert verdict_of(named=True, is_adequate=False, leading=True, gain=gain_between(2.2, 2.3)) == "partly-explained"
    less = gain_between(2.2, 2.3, baseline_m=4e-5)
    assert verdict_of(named=True, is_adequate=False, leading=True, gain=less) == "unknown-cause"
    assert verdict_of(named=True, is_adequate=False, leading=True, gain=None) == "unknown-cause"
    account = account_of(searched(900.0, a=700.0, b=100.0), 200.0, False)
    assert [account.leads(name) for name in ("a", "b", "c")] == [True, False, False]
    assert not account_of(searched(900.0, a=700.0, b=100.0), 200.0, False, doubted=["a"]).leads("a")


def test_names_that_explain_most_of_it_jointly_may_imitate_another() -> None:
    account = account_of(searched(900.0, a=250.0, b=100.0), 0.0, True)

    assert account.jointly == pytest.approx(550.0 / 900.0)
    assert account.overlaps
    assert not account.leads("a")
    assert verdict_of(named=True, is_adequate=True, leading=False, gain=gain_between(1.15, 1.25)) == "unknown-cause"


@pytest.mark.parametrize("counted", [False, True])
def test_names_that_explain_most_of_it_jointly_do_not_hold_where_nothing_is_left_either(counted: bool) -> None:
    overlapping, distinct = (searched(900.0, a=gain, b=100.0) for gain in (250.0, 500.0))

    verdicts = [
        judge(
            selection, None, None, account_of(selection, 0.0, True), is_adequate=True, finished=True, counted=counted
        ).verdict
        for selection in (overlapping, distinct)
    ]

    assert verdicts == ["unknown-cause", "causes-found"]


def test_names_that_take_less_than_half_on_the_judge_recordings_may_only_be_confounders() -> None:
    assert (
        verdict_of(named=True, is_adequate=True, leading=True, gain=gain_between(1.15, 1.25, baseline_m=1.6e-5))
        == "partly-explained"
    )
    assert (
        verdict_of(named=True, is_adequate=True, leading=True, gain=gain_between(1.15, 1.25, baseline_m=1.3e-5))
        == "unknown-cause"
    )


def test_a_cause_takes_no_more_than_all_of_them_gain() -> None:
    """A model without it that was not fitted to its end is worse than the paper's, which it holds."""
    account = account_of(searched(1500.0, a=16e6, b=500.0), 0.0, True)

    assert account.gains == {"a": 1500.0, "b": 500.0}
    assert account.cause_shares == pytest.approx({"a": 0.75, "b": 0.25})


@cache
def gap_diagnosis() -> Diagnosis:
    """Return a diagnosis as the search would leave it: its confidence fits the verdict, its sentence the numbers."""
    result = diagnosis("air-gap-offset", 5e-4)
    return replace(result, sentence=summary_sentence(result))


def partly() -> Diagnosis:
    """The same where the judge recordings show more than noise."""
    result = gap_diagnosis()
    assert result.gain is not None
    low = TOLERANCE + 0.1
    above_floor = replace(result.gain, extended_rmse_m=result.gain.floor_m * (low + 0.05), ci95_floor=(low, low + 0.1))
    above_floor = replace(above_floor, ci95_ratio=(0.0, 1.0))
    gains = tuple(above_floor if gain is result.gain else gain for gain in result.gains)
    (cause,) = result.causes
    cause = replace(cause, confidence=settings.MAX_CONFIDENCE["partly-explained"])
    result = replace(
        result,
        verdict=verdict_of(named=True, is_adequate=True, leading=True, gain=above_floor),
        gain=above_floor,
        gains=gains,
        causes=(cause,),
        unexplained_where=beyond_sentence(above_floor),
    )
    return replace(result, sentence=summary_sentence(result))


def test_the_numbers_of_a_diagnosis_agree() -> None:
    assert disagreements(to_json(gap_diagnosis())) == []


def test_an_answer_that_leaves_more_than_noise_on_the_judge_recordings_says_so_everywhere() -> None:
    result = partly()
    data = to_json(result)

    assert disagreements(data) == []
    assert data["verdict"] == "partly-explained"
    assert "not everything is explained on the judge recordings" in data["sentence"]
    assert data["gain"]["judge"]["ci95_over_floor"][0] > TOLERANCE


def test_the_page_says_of_which_quantity_each_share_is() -> None:
    show = summarise(gap_diagnosis(), controller(), quick=True)
    whole, part = (
        " ".join(
            re.sub(
                r"<[^>]+>", " ", to_html(replace(result, quick=True), show, campaign=Path("c"), out=Path("o"))
            ).split()
        )
        for result in (gap_diagnosis(), partly())
    )

    for text in (whole, part):
        assert "over 99 % of the log-likelihood that the model lacks on the recordings for fitting" in text
        assert "On the judge recordings extending the model cuts the 20 ms prediction error" in text
        assert "confidence in the name" in text
    assert "Nothing measurable is left: the rest is white" in whole
    assert "Nothing measurable is left of the recordings for fitting" in part
    assert "but not everything is explained on the judge recordings" in part


def changed(data: dict[str, Any], path: str, value: object) -> dict[str, Any]:
    """A copy with one number another."""
    data = copy.deepcopy(data)
    *before, last = path.split(".")
    node: Any = data
    for key in before:
        node = node[int(key)] if isinstance(node, list) else node[key]
    node[last] = value
    return data


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("causes.0.share_of_excess_explained", 0.72),
        ("causes.0.share_of_excess_explained", 1.2),
        ("unexplained.share_of_excess", 0.1),
        ("jointly_explained.share_of_excess", 0.1),
        ("excess.left", 500.0),
        ("verdict", "model-adequate"),
        ("verdict", "unknown-cause"),
        ("verdict", "partly-explained"),
        ("causes.0.confidence", 0.999),
        ("gain.judge.ci95_over_floor", [1.15, 1.25]),
        ("gain.judge.extended_rmse_m", 9e-5),
        ("gain.judge.noise_floor_m", 9e-7),
        ("gains.0.judge.excess_removed", 0.5),
        ("sentence", "The coil sits 0.50 mm higher than in the model: this explains 72 % of what is missing."),
    ],
)
def test_a_number_that_contradicts_the_others_is_found(path: str, value: object) -> None:
    assert disagreements(changed(to_json(gap_diagnosis()), path, value))


def test_the_interval_of_error_over_floor_covers_1_under_noise_and_too_short_a_recording_has_none() -> None:
    rng, block, covered = np.random.default_rng(5), 50, 0
    for seed in range(100):
        squares = 4.0 * rng.standard_normal(100 * block) ** 2
        low, high = bootstrap(np.full_like(squares, 4.0), squares, block, seed)
        covered += low <= 1.0 <= high

    assert covered >= 88  # 93 % at least, less 2 standard deviations of 100 trials
    short = diagnosis("air-gap-offset", 5e-4, seconds=0.5 * settings.ERROR_BLOCKS - 1.0)
    assert all(not np.isfinite(gain.ci95_floor[0]) for gain in short.gains)
