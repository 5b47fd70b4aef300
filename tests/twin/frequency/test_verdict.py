"""The answer in words: false alarms as rare as stated, and a hidden difference named with its size."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from tests.harness.twin.linear_loops import LAW, Loop
from tests.twin.frequency.test_spectra import FLIGHTS, NOISE, RIG, TESTED, compared, flown, quiet, true_responses
from twin.frequency.compare import Deviations
from twin.frequency.responses import Name, pairs
from twin.frequency.spectra import Spectra
from twin.frequency.verdict import LEVEL, Tested, judge

REFERENCE = "fast multisine"


def compared_with_rig(s: Spectra, x_m: float = 2.85e-3) -> Tested:
    """A flight against the right model of RIG."""
    differences: dict[Name, Deviations] = {}
    certain = {}
    q = quiet(REFERENCE, RIG)
    for name in TESTED:
        differences[name] = compared(s, q, RIG, name)
        top, bottom = pairs(s, LAW)[name]
        h = true_responses(RIG, s.bins_hz)[name]
        certain[name] = np.sqrt(s.variance(top - h * bottom)) < 0.3 * np.abs(differences[name].predicted)
    return x_m, differences, certain


@pytest.mark.sample
def test_a_right_model_is_refused_at_most_as_often_as_stated() -> None:
    flights = [compared_with_rig(s) for s in flown(REFERENCE, RIG)]
    pairs_of_heights = list(zip(flights[::2], flights[1::2], strict=True))

    alarms = sum(not judge(both).explains for both in pairs_of_heights)

    assert alarms <= binom.ppf(0.999, FLIGHTS // 2, LEVEL)
    sentence = judge(pairs_of_heights[0]).sentence
    assert sentence.startswith("The model explains the loop at 4 to ")
    assert "two heights" in sentence or "2 heights" in sentence


@pytest.mark.parametrize(
    ("hidden", "response", "kind", "size", "words"),
    [
        ({"delay_s": 1.2e-3}, "plant (u_c to x)", "delay", 1.2e-3, "lags"),
        ({"K_A": 0.297 * 0.9}, "amplifier (u_c to i_c)", "gain", 0.9, "% lower"),
        ({"lag_s": 3e-3}, "plant (u_c to x)", "lag", 3e-3, "lags"),
    ],
)
def test_what_is_hidden_is_named_with_its_size(
    hidden: dict[str, float], response: str, kind: str, size: float, words: str
) -> None:
    for s in flown(REFERENCE, Loop(noise=NOISE, **hidden), flights=5):
        answer = judge([compared_with_rig(s)])

        assert answer.explains is False
        assert words in answer.sentence
        assert response in answer.sentence
        test = next(candidate for candidate in answer.tests if candidate.failed and candidate.name in response)
        form = next(candidate for candidate in test.forms if candidate.kind == kind)
        wide = form.high - form.low
        assert form.low - wide < size < form.high + wide
        assert form.text.split(" (")[0] in answer.sentence


def test_without_an_excited_flight_there_is_no_answer() -> None:
    answer = judge([])

    assert answer.explains is None
    assert "excitation" in answer.sentence
