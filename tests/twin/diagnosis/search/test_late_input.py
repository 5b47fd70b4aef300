"""A delay that T_A has been standing in for: where it is seen, where its fit begins, and what does the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.simulated_rig import THETA, criterion_of, fitted, narrow, strong
from twin.diagnosis.search.candidate_fits import fit_candidates as tried
from twin.diagnosis.search.forward_step import forward
from twin.diagnosis.search.score_test import screen
from twin.diagnosis.search.stepwise import select
from twin.diagnosis.search.task import Search
from twin.estimation.record import Record
from twin.evidence.dead_time import dead_time
from twin.inference.fisher_scoring import narrowing
from twin.inference.noise_floor import floor_of
from twin.model.causes.catalogue import BY_NAME

FAST = replace(THETA, T_A=1.2e-4)
DELAY_S = 1.73e-3
DELAYS = [BY_NAME[name] for name in ("actuation-delay", "sampling-delay", "eddy-current-lag")]


@pytest.fixture(scope="module")
def delayed_records() -> list[Record]:
    return narrow(strong("actuation-delay", DELAY_S, FAST), seconds=3.0)


def test_steps_show_the_delay_and_the_time_constant_together(delayed_records: list[Record]) -> None:
    estimate = dead_time(delayed_records)

    assert estimate is not None
    assert estimate[0] == pytest.approx(DELAY_S, abs=6e-5)  # a sample and a half
    assert estimate[1] == pytest.approx(FAST.T_A, rel=0.2)


def test_a_step_that_is_not_late_asks_for_none() -> None:
    estimate = dead_time(narrow(THETA, seconds=0.5))

    assert estimate is None or estimate[0] <= 8e-5


def test_slow_samples_tell_neither(delayed_records: list[Record]) -> None:
    assert dead_time([replace(record, captures=()) for record in delayed_records]) is None


def test_a_delay_is_found_behind_the_time_constant_that_stood_in_for_it(delayed_records: list[Record]) -> None:
    """The slope of the likelihood without a delay promises a thousandth of what the delay is worth."""
    criterion = criterion_of(delayed_records)
    base = fitted(criterion, THETA)
    task = Search(criterion=criterion, floor=floor_of(criterion, base.theta), candidates=DELAYS, max_candidates=3)
    slope_gains = {score.cause: score.gain for score in screen(criterion, base.theta, base.free, DELAYS)}

    step = forward(task, base, base)

    assert base.theta.T_A > 4.0 * FAST.T_A
    assert step.selected == "actuation-delay"
    assert step.trials[0].fit.theta.value("actuation-delay.delay_s") == pytest.approx(DELAY_S, rel=0.01)
    assert step.trials[0].fit.theta.T_A == pytest.approx(FAST.T_A, rel=0.05)
    assert step.trials[0].gain > 20.0 * slope_gains["actuation-delay"]
    criterion.close()


@pytest.mark.slow
def test_what_does_the_same_is_fitted_once_and_named_twice(delayed_records: list[Record]) -> None:
    criterion = criterion_of(delayed_records)
    base = fitted(criterion, THETA)
    scores = screen(criterion, base.theta, base.free, DELAYS[:2])
    before = criterion.evaluations
    (first_trial,) = tried(criterion, base, scores[:1])
    evaluations = criterion.evaluations - before

    both = tried(criterion, base, scores)

    assert criterion.evaluations - before == 2 * evaluations
    assert [trial.cause for trial in both] == ["actuation-delay", "sampling-delay"]
    assert both[0].gain == both[1].gain == first_trial.gain
    assert both[1].fit.free[-2:] == ("sampling-delay.delay_s", "sampling-delay.in_captures")
    shapes = narrowing(both[1].fit.free, both[1].fit.covariance)
    assert criterion.value(both[1].fit.theta) + shapes == pytest.approx(both[0].fit.loglik, abs=1e-6)
    # The jitter has led across the kinks of the likelihood, and is gone.
    assert both[0].fit.theta.value("actuation-delay.delay_s") == pytest.approx(DELAY_S, rel=1e-3)
    assert both[0].fit.theta.value("actuation-delay.jitter_s") == 0.0
    selection = select(Search(criterion=criterion, floor=floor_of(criterion, base.theta), candidates=DELAYS), base)
    assert selection.causes == ("actuation-delay",)
    assert [trial.cause for trial in selection.classes["actuation-delay"]] == ["sampling-delay"]
    criterion.close()


def test_the_delay_of_captures_is_that_of_their_samples(delayed_records: list[Record]) -> None:
    """A recording at 25 kHz says what its captures would."""
    (bursts, *_) = delayed_records
    capture = bursts.captures[0]
    n = len(capture.i_c_a)
    u = np.where(np.arange(n) < capture.step_index, capture.u_from_v, capture.u_to_v)
    missing = np.full(n, np.nan)
    t = np.arange(n, dtype=np.float64) * capture.sample_time_s
    whole = replace(bursts, captures=(), t=t, u_c=u, i_c=capture.i_c_a, x=missing, x_ref=missing)

    from_samples, from_capture = dead_time([whole]), dead_time([replace(bursts, captures=(capture,))])

    assert from_samples is not None
    assert from_capture is not None
    assert from_samples[0] == pytest.approx(from_capture[0], abs=4.1e-5)
