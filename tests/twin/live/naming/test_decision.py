"""The decision over windows, on evidence that is drawn: how often noise makes a name, and what makes none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.simulated_rig import THETA
from twin.live.naming import decision as rules
from twin.live.naming.decision import Decision, Proposal, min_gain, without_best
from twin.live.naming.evidence import Signature, WindowEvidence
from twin.live.naming.windows import Window
from twin.settings.naming import FORGOTTEN_S, WINDOW_S, WINDOWS

TRUE, RIVAL, NON_NEGATIVE = "constant-force", "sensor-crosstalk", "coulomb-friction"
CAUSES = (TRUE, RIVAL, NON_NEGATIVE)
INFORMATION = 4.0


def window(number: int, session: int = 1) -> Window:
    from_s = number * WINDOW_S
    return Window(
        session=session,
        from_s=from_s,
        to_s=from_s + 2.0,
        from_ns=round(from_s * 1e9),
        sample_time_s=2e-3,
        i_lsb_a=0.0,
        x_lsb_m=0.0,
        readings=np.empty((0, 3)),
    )


def evidence(number: int, slopes: list[float], causes: tuple[str, ...] = CAUSES) -> WindowEvidence:
    probes = {TRUE: 1e-3, RIVAL: 2e-5, NON_NEGATIVE: 5e-4}
    return WindowEvidence(
        window=window(number),
        theta=THETA,
        signatures=tuple(
            Signature(cause=cause, probe=probes[cause], slope=slope, information=INFORMATION)
            for cause, slope in zip(causes, slopes, strict=True)
        ),
    )


def decided(rows: list[list[float]]) -> tuple[Decision, Proposal | None]:
    decision = Decision()
    for number, slopes in enumerate(rows):
        decision.add(evidence(number, slopes))
    return decision, decision.proposal


QUIET, STRONG = [0.5, -0.5, 0.3], [20.0, 1.0, 1.0]  # gains of 0.03 and 50


def test_noise_names_no_more_often_than_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bound of 20 false names in 2000 windows; overlapping sums and the best window left out make fewer."""
    count, bound = 2000, 20.0
    monkeypatch.setattr(rules, "FALSE_NAMES_PER_WEEK", bound / count * rules.WEEK_S / WINDOW_S)
    rng, decision, named = np.random.default_rng(20260614), Decision(), 0

    for number in range(count):
        slopes = (np.sqrt(INFORMATION) * rng.standard_normal(len(CAUSES))).tolist()
        named += decision.add(evidence(number, slopes)) is not None

    assert named <= bound


def test_the_threshold_is_that_of_one_name_a_week() -> None:
    """For as many windows, onsets and probes as a week has; P(|z| > sqrt(2 gain)) = erfc(sqrt(gain))."""
    tests = 7 * 86400 / WINDOW_S * WINDOWS * 34

    assert tests * math.erfc(math.sqrt(min_gain(34))) == pytest.approx(1.0, rel=1e-6)
    assert 16.0 < min_gain(34) < 16.5


def test_the_onset_and_the_size_are_found() -> None:
    _, named = decided([QUIET] * 5 + [STRONG] * 4)

    assert named is not None
    assert (named.cause, named.others) == (TRUE, ())
    assert named.since.from_s == window(5).from_s
    assert named.strength == pytest.approx(20.0 / INFORMATION * 1e-3, rel=0.1)
    assert named.probability == pytest.approx(0.9, abs=0.01)


def test_a_single_window_makes_no_name_however_strong() -> None:
    _, named = decided([QUIET] * 3 + [[1000.0, 0.0, 0.0]] + [QUIET] * 3)

    assert named is None


def test_a_sign_that_the_cause_cannot_have_is_no_evidence() -> None:
    assert decided([[0.0, 0.0, -20.0]] * 4)[1] is None
    assert decided([[0.0, -20.0, 0.0]] * 4)[1] is not None


def test_causes_that_do_as_well_are_named_with_it_and_the_name_stays() -> None:
    decision, named = decided([[20.0, 19.5, 0.0]] * 4)
    assert named is not None
    assert (named.cause, named.others) == (TRUE, (RIVAL,))
    assert named.probability < 0.6

    for number in range(4, 10):
        named = decision.add(evidence(number, [19.5, 20.0, 0.0]))

    assert named is not None
    assert named.cause == TRUE


def test_a_cause_of_a_possible_size_goes_first() -> None:
    """A constant force of 0.1 N would lift the ball of 0.08 N; dry friction of 0.049 N is within its range."""
    _, named = decided([[400.0, 0.0, 390.0]] * 4)

    assert named is not None
    assert (named.cause, named.others) == (NON_NEGATIVE, (TRUE,))
    assert named.strength == pytest.approx(390.0 / INFORMATION * 5e-4)


def test_a_name_ends_when_the_newest_windows_contradict_it() -> None:
    decision, named = decided([STRONG] * 6)
    assert named is not None

    ended = [decision.add(evidence(6 + n, QUIET)) is None for n in range(4)]

    assert ended[-1]


def test_another_session_or_a_pause_begins_anew() -> None:
    for other in (window(3, session=2), replace(window(3), from_s=FORGOTTEN_S + 20.0, to_s=FORGOTTEN_S + 22.0)):
        decision, named = decided([STRONG] * 3)
        assert named is not None
        assert decision.add(replace(evidence(3, STRONG), window=other)) is None


def test_other_probes_begin_anew() -> None:
    decision, _ = decided([STRONG] * 3)

    assert decision.add(evidence(3, [20.0], causes=(TRUE,))) is None


def test_sums_leave_out_the_best_window() -> None:
    slopes, information = np.array([[1.0], [5.0], [2.0]]), np.ones((3, 1))

    sums, left = without_best(slopes, information)

    assert sums[:, 0].tolist() == [3.0, 2.0, 0.0]
    assert left[:, 0].tolist() == [2.0, 1.0, 0.0]


def test_the_onset_of_a_name_outlasts_the_memory() -> None:
    decision, named = decided([QUIET] * 2 + [STRONG] * (WINDOWS + 5))

    assert named is not None
    assert named.since.from_s == window(2).from_s
    assert len(decision._windows) == WINDOWS
