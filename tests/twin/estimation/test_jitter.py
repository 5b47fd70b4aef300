"""A delay that is drawn at each tick: a flight with known delays, and what the filter says of them."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.harness.diagnose.known_diagnosis import QUIET, campaign, fit_of, steps
from tests.harness.diagnose.simulated_rig import MIDDLE_M, PLANT, TICK_S
from twin.diagnosis.judge.prediction_gain import predictions
from twin.diagnosis.report.model_file import model_of
from twin.diagnosis.search.candidate_fits import Trial, renamed
from twin.estimation.prediction_floor import floor_rmse
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion, mean_square
from twin.inference.theta import BASE, Theta
from twin.mirror.observer import observe, observer_of
from twin.model.equilibrium import at_rest
from twin.model.extended import I_C, V, X
from twin.model.integration import FREE, advance
from twin.model.simulate import plant_numbers

DELAY, JITTER, IN_CAPTURES = (f"actuation-delay.{name}" for name in ("delay_s", "jitter_s", "in_captures"))
DELAY_S, JITTER_S = 0.8e-3, 0.2e-3
SECONDS = 12.0


def flight(jitter_s: float, seed: int) -> Record:
    """A ball under a PD law with a dither of 0.3 V; each input acts late, by a delay drawn evenly about `DELAY_S`."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS / TICK_S)
    base, c = QUIET.base(PLANT), QUIET.vector()
    y, u_0 = at_rest(base, c, MIDDLE_M)
    rows, before = np.empty((n, 4)), u_0
    for k in range(n):
        target_m = MIDDLE_M + 0.5e-3 * (1.0 if k % 300 < 150 else -1.0)
        u = u_0 + 900.0 * (target_m - y[X]) - 22.0 * y[V] + 0.3 * rng.normal()
        rows[k] = u, y[I_C] + QUIET.sigma_i_c_a * rng.normal(), y[X] + QUIET.sigma_x_m * rng.normal(), target_m
        delay_s = DELAY_S + jitter_s * math.sqrt(3.0) * rng.uniform(-1.0, 1.0)
        advance(tuple(base), c, y, before, 0.0, delay_s, FREE)
        advance(tuple(base), c, y, u, 0.0, TICK_S - delay_s, FREE)
        before = u
    t = TICK_S * np.arange(n, dtype=np.float64)
    return replace(
        steps(QUIET, seed=1, seconds=0.5), t=t, u_c=rows[:, 0], i_c=rows[:, 1], x=rows[:, 2], x_ref=rows[:, 3]
    )


@cache
def fits(jitter_s: float) -> tuple[Fit, Fit, float]:
    """Return (the fit with a fixed delay, with a drawn one, the mean square of the latter's whitened innovations)."""
    criterion = Criterion(gather([flight(jitter_s, 5)], PLANT), PLANT, TICK_S, workers=1)
    try:
        start = QUIET.having(DELAY, DELAY_S).having(IN_CAPTURES, 1.0)
        fixed = climb(criterion, start, (*BASE, DELAY))
        drawn = climb(criterion, fixed.theta.having(JITTER, 0.0), (*BASE, DELAY, JITTER), passes=60)
        return fixed, drawn, mean_square(criterion.outputs(drawn.theta))
    finally:
        criterion.close()


@pytest.mark.slow
def test_how_far_a_delay_varies_is_found() -> None:
    """Within four standard errors, and what is left is white noise."""
    fixed, drawn, white = fits(JITTER_S)
    assert drawn.loglik > fixed.loglik + 20.0
    assert abs(drawn.theta.value(JITTER) - JITTER_S) < 2.5 * drawn.std(JITTER, PLANT)
    assert drawn.std(JITTER, PLANT) < 0.05 * JITTER_S
    assert abs(drawn.theta.value(DELAY) - DELAY_S) < 4.0 * drawn.std(DELAY, PLANT)
    assert drawn.std(DELAY, PLANT) < fixed.std(DELAY, PLANT)
    assert white == pytest.approx(1.0, abs=0.05)
    # What the ball has felt of a late input, although i_c no longer shows it, is no disturbance of its own.
    assert drawn.theta.process_a_m_s2 < 0.5 * fixed.theta.process_a_m_s2


@pytest.mark.slow
def test_a_delay_that_varies_is_none_of_the_sensors() -> None:
    """A fixed delay may be that of both sensors as well: the recordings show no difference."""
    gains = []
    for jitter_s in (0.0, JITTER_S):
        fixed, drawn, _ = fits(jitter_s)
        criterion = Criterion(gather([flight(jitter_s, 5)], PLANT), PLANT, TICK_S, workers=1)
        try:
            trial = Trial(cause="actuation-delay", fit=drawn, gain=drawn.loglik - fixed.loglik)
            gains.append((trial.gain, renamed(criterion, trial, "sampling-delay").gain))
        finally:
            criterion.close()
    (same, copied), (varies, stays) = gains

    assert copied == pytest.approx(same, abs=4.0)
    assert stays == pytest.approx(0.0, abs=4.0)
    assert varies > stays + 1000.0


@pytest.mark.slow
def test_a_fixed_delay_does_not_vary() -> None:
    fixed, drawn, _ = fits(0.0)
    assert drawn.loglik < fixed.loglik + 4.0
    assert drawn.theta.value(JITTER) < 0.1 * JITTER_S


def known(jitter_s: float) -> Theta:
    return QUIET.having(DELAY, DELAY_S).having(IN_CAPTURES, 1.0).having(JITTER, jitter_s)


@pytest.mark.parametrize("samples", [1, 5])
def test_the_floor_of_a_prediction_knows_that_the_delay_varies(samples: int) -> None:
    """The error of the true model is what its floor says; a floor without the jitter is far below it.

    To 6 %: while an input acts, the slope of the force changes with the current, and the floor has that from before.
    """
    evidence = gather([flight(JITTER_S, 6)], PLANT)
    error = predictions(evidence, known(JITTER_S), PLANT, TICK_S, samples) - evidence.series.x
    predicted = np.isfinite(error)
    measured = math.sqrt(float(np.mean(error[predicted] ** 2)))

    floor, fixed = (
        floor_rmse(known(jitter_s).system(PLANT, TICK_S), evidence.samples, samples, predicted)
        for jitter_s in (JITTER_S, 0.0)
    )

    assert measured / floor == pytest.approx(1.0, abs=0.06)
    assert measured / fixed > 1.1


def test_the_live_observer_expects_it() -> None:
    """Its NIS has the mean 2 of a right model, but for that slope; as a fixed delay the same flight looks wrong."""
    record = flight(JITTER_S, 6)

    def mean_nis(jitter_s: float) -> float:
        model = model_of(campaign(), fit_of(known(jitter_s), 0.0), {}, [record], 0.0, "")
        observer = tuple(observer_of(plant_numbers(model, TICK_S), model.noise))
        rows = [
            observe(observer, k > 0, True, False, record.i_c[k], record.x[k], record.u_c[k])
            for k in range(len(record.t))
        ]
        return float(np.mean([nis for _, _, nis, valid in rows if valid]))

    assert mean_nis(JITTER_S) == pytest.approx(2.0, abs=0.2)
    assert mean_nis(0.0) > 4.0
