"""Shapes: a prior where the data are silent, and integrated out where fits are compared."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.known_diagnosis import QUIET
from twin.diagnose.evidence.gather import gather
from twin.diagnose.inference.fisher_scoring import climb, narrowing
from twin.diagnose.inference.initial_guess import start_theta
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.theta import BASE, STOPS, coordinates_of, prior_spread, shape_residuals
from twin.diagnose.pipeline import tick_of
from twin.diagnose.search.score_test import probed
from twin.model.causes.catalogue import BY_NAME
from twin.readers.campaign import read_campaign

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


def test_a_delay_that_varies_is_found_with_its_standard_deviation(tmp_path: Path) -> None:
    """Drawn anew for each input between 0 and 1 ms: 0.5 ms, give or take 0.29."""
    make_campaign(tmp_path, effects={"delay-jitter": 5e-4}, seed=8, plant="textbook", quick=True)
    campaign = load(tmp_path)
    records = [record for record in read_campaign(campaign) if record.kind == "closed-loop"]
    criterion = Criterion(gather(records, campaign.plant), campaign.plant, tick_of(records), workers=1)
    cause = BY_NAME["actuation-delay"]
    try:
        base = climb(criterion, start_theta(records, campaign.plant), (*BASE, *STOPS))
        free = (*base.free, *coordinates_of(cause.name))
        start = probed(base.theta, cause, 5e-4, [("actuation-delay.jitter_s", 3e-4)])
        found = climb(criterion, start, free)
        constant = climb(criterion, start.having("actuation-delay.jitter_s", 0.0), (*base.free, free[-2]))
    finally:
        criterion.close()

    # The filter takes the error of i_c for proportional to that of the delay: with so short a T_A it grows faster.
    assert found.theta.value("actuation-delay.delay_s") == pytest.approx(5e-4, abs=2.5e-4)
    assert found.theta.value("actuation-delay.jitter_s") == pytest.approx(1e-3 / math.sqrt(12.0), rel=0.15)
    assert found.loglik > constant.loglik + 50.0
