"""A force law whose power in the middle of the travel is 2, so that only the shape is unusual."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.harness.diagnose.simulated_rig import ITEMS, THETA, criterion_of, made, narrow
from tests.twin.diagnosis.remainder.test_remainder import paper_model
from twin.diagnosis.search.candidate_fits import start_trial
from twin.diagnosis.search.score_test import screen
from twin.inference.fisher_scoring import climb
from twin.inference.theta import BASE
from twin.model.causes.catalogue import BY_NAME


@pytest.mark.slow
def test_an_exponential_force_with_the_usual_power_in_the_middle_has_the_best_score(tmp_path: Path) -> None:
    effects = {"gap-exponential": 2.57e-3}
    with paper_model(tmp_path, {}, effects=effects, seed=12880, plant="textbook") as (criterion, base):
        scores = screen(criterion, base.theta, base.free)

    assert scores[0].cause == "force-exponent"


@pytest.mark.slow
@pytest.mark.parametrize("bend", [2.0, -2.0])
def test_the_start_of_the_fit_has_the_sign_of_the_shape(bend: float) -> None:
    bent = THETA.having("force-exponent.n", 2.0).having("force-exponent.bend", bend)
    criterion = criterion_of([*made(ITEMS["wide-steps"], bent), *narrow(bent)])
    try:
        base = climb(criterion, THETA, BASE)
        (score,) = screen(criterion, base.theta, base.free, [BY_NAME["force-exponent"]])
        trial = start_trial(criterion, base, score)
        truth = criterion.value(bent)
    finally:
        criterion.close()

    assert trial.gain > 0.5 * (truth - base.loglik)
    assert trial.fit.theta.value("force-exponent.bend") == pytest.approx(bend, rel=0.5)
