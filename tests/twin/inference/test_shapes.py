"""Shapes: a prior where the data are silent, and integrated out where fits are compared."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.known_diagnosis import QUIET
from twin.inference.fisher_scoring import narrowing
from twin.inference.theta import prior_spread, shape_residuals

KNEE, EXTRA = "core-saturation.knee", "coulomb-friction.extra"


def test_a_shape_counts_in_standard_deviations_of_its_prior() -> None:
    usual, bent = replace(QUIET, causes=()), replace(QUIET, causes=((KNEE, 1.0), (EXTRA, 1.0)))

    assert not shape_residuals(usual).any()
    assert sorted(shape_residuals(bent)[shape_residuals(bent) != 0.0].tolist()) == [-1.0, 2.0]


def test_the_narrowing_of_a_parabola_is_its_integral() -> None:
    """Of a Gaussian likelihood with a Gaussian prior Laplace's method is exact: against a sum over a grid."""
    spread = prior_spread(KNEE)
    error, at = 0.2 * spread, 0.7 * spread  # of the likelihood alone
    grid = np.linspace(-8.0 * spread, 8.0 * spread, 20001)
    log_likelihood = -0.5 * ((grid - at) / error) ** 2
    log_prior = -0.5 * (grid / spread) ** 2
    integral = math.log(np.trapezoid(np.exp(log_likelihood + log_prior), grid) / (math.sqrt(2.0 * math.pi) * spread))
    variance = 1.0 / (1.0 / error**2 + 1.0 / spread**2)
    covariance = np.diag([1.0, variance])

    assert float(np.max(log_likelihood + log_prior)) + narrowing(["K_A", KNEE], covariance) == pytest.approx(
        integral, abs=1e-6
    )


def test_a_shape_that_the_data_leave_open_or_that_is_at_its_bound_costs_nothing() -> None:
    open_ = np.diag([1e-6, prior_spread(KNEE) ** 2])
    at_its_bound = np.diag([1e-6, 0.0])

    assert narrowing(["K_A", KNEE], open_) == pytest.approx(0.0, abs=1e-12)
    assert narrowing(["K_A", KNEE], at_its_bound) == 0.0
    assert narrowing(["K_A"], np.eye(1)) == 0.0
