"""The evidence outside the series: points of lift-off, read by sensors whose offsets wander."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tests.harness.diagnose.simulated_rig import PLANT, THETA
from twin.evidence.starting.liftoff import LiftOff
from twin.inference.outside import Outside
from twin.inference.theta import Theta, derivative_step, moved, parameter_of

WANDER_I, WANDER_X = "current-sensor-offset.wander_a", "position-sensor-offset.wander_m"
RELATIVE_ERROR = 0.01  # of K_c
ERRORS = (1.004, 0.99, 1.012, 1.003)  # of the currents


def lift_off(recording: str, t_s: float, gap_m: float, error: float) -> LiftOff:
    """A lift-off at a current that is off by that factor."""
    i = error * gap_m * math.sqrt(PLANT.mass_kg * PLANT.gravity_m_s2 / THETA.K_c)
    return LiftOff(recording=recording, t_s=t_s, gap_m=gap_m, i_c_a=i, K_c=THETA.K_c, relative_error=RELATIVE_ERROR)


POINTS = (
    lift_off("a", 3.0, 4e-3, ERRORS[0]),
    lift_off("a", 90.0, 4e-3, ERRORS[1]),
    lift_off("b", 2.0, 5e-3, ERRORS[2]),
    lift_off("b", 3.0, 7e-3, ERRORS[3]),
)
OUTSIDE = Outside(statics=POINTS, plant=PLANT, share=1.0)


def wandering(i_a: float, x_m: float) -> Theta:
    return THETA.having(WANDER_I, i_a).having(WANDER_X, x_m)


def log_density(i_a: float, x_m: float) -> float:
    """The density of the errors of the currents: each recording has a walk of its own, a minute old at its start."""
    covariance = np.diag(np.full(len(POINTS), (0.5 * RELATIVE_ERROR) ** 2))
    for n, one in enumerate(POINTS):
        for k, other in enumerate(POINTS):
            if one.recording == other.recording:
                minutes = 1.0 + min(one.t_s, other.t_s) / 60.0
                in_i, in_x = i_a**2 / (one.i_c_a * other.i_c_a), x_m**2 / (one.gap_m * other.gap_m)
                covariance[n, k] += minutes * (in_i + in_x)
    return float(multivariate_normal.logpdf(np.log(ERRORS), cov=covariance))


@pytest.mark.parametrize("wander", [(4e-3, 0.0), (0.0, 30e-6), (4e-3, 30e-6)])
def test_a_lift_off_says_no_more_than_its_sensors_do(wander: tuple[float, float]) -> None:
    expected = log_density(*wander) - log_density(0.0, 0.0)

    change = OUTSIDE.loglik(wandering(*wander)) - OUTSIDE.loglik(THETA)

    spreads = (parameter_of(name).spread for name in (WANDER_I, WANDER_X))
    prior = 0.5 * sum((size / spread) ** 2 for size, spread in zip(wander, spreads, strict=True))
    assert change == pytest.approx(expected - prior, rel=0.02)
    assert OUTSIDE.points(wandering(*wander)) > OUTSIDE.points(THETA)


def test_the_score_is_the_slope_of_the_likelihood() -> None:
    theta, names = wandering(4e-3, 30e-6), (WANDER_I, WANDER_X, "K_c")
    steps = [derivative_step(theta, name, PLANT) for name in names]
    models = [moved(theta, name, step, PLANT) for name, step in zip(names, steps, strict=True)]

    score, fisher = OUTSIDE.slopes(theta, models, steps)

    slopes = [(OUTSIDE.loglik(model) - OUTSIDE.loglik(theta)) / step for model, step in zip(models, steps, strict=True)]
    assert score == pytest.approx(slopes, rel=0.02)
    assert np.all(np.linalg.eigvalsh(fisher) > -1e-9)
