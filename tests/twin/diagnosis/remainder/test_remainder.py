"""A force that no cause explains is found as a curve of the right size; none is found where nothing is hidden.

The recordings are those of the independent plant, whose wire spring no catalogue has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import PlantName, draw_rig, make_campaign
from tests.harness.diagnose.second_plant import WIRE_FROM_M
from twin.diagnosis import assemble
from twin.diagnosis.judge.flexible import flexible_errors
from twin.diagnosis.remainder.curve_fits import basis, scores
from twin.diagnosis.remainder.remainder import CurveJudge, Remainder, remainder_of
from twin.evidence.gather import gather
from twin.inference.budget import Budget, Spent
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.initial_guess import start_theta, with_noise_bounds
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, STOPS
from twin.model.causes import curve
from twin.model.causes.catalogue import neutral
from twin.readers.campaign import read_campaign

STIFFNESS_N_M3 = 1.6e6
SEED = 11


@contextmanager
def paper_model(
    folder: Path,
    outside: Mapping[str, float],
    *,
    effects: Mapping[str, float] | None = None,
    seed: int = SEED,
    plant: PlantName = "independent",
) -> Iterator[tuple[Criterion, Fit]]:
    """The paper's model at its best on a campaign with these effects, of the catalogue and outside it."""
    make_campaign(folder, effects=effects or {}, outside=outside, seed=seed, plant=plant, quick=True)
    campaign = load(folder)
    records = read_campaign(campaign)
    evidence = gather(records, campaign.plant)
    criterion = Criterion(evidence, campaign.plant, 2e-3, budget=Budget())
    try:
        start = with_noise_bounds(start_theta(records, campaign.plant), evidence)
        yield criterion, climb(criterion, start, (*BASE, *STOPS))
    finally:
        criterion.close()


def modelled(folder: Path, criterion: Criterion, fit: Fit, candidates: bool = False) -> Remainder | None:
    """The remainder of that fit."""
    campaign = load(folder)
    judge = gather(read_campaign(campaign, use="judge"), campaign.plant)
    causes = assemble.testable_causes(criterion.evidence.records, ()) if candidates else ()
    return remainder_of(CurveJudge(criterion, judge, 0), fit, floor_of(criterion, fit.theta), causes, rival=None)


@pytest.fixture(scope="module")
def of_wire(tmp_path_factory: pytest.TempPathFactory) -> Remainder:
    folder = tmp_path_factory.mktemp("remainder") / "wire"
    with paper_model(folder, {"wire-spring": STIFFNESS_N_M3}) as (criterion, fit):
        remainder = modelled(folder, criterion, fit)
    assert remainder is not None
    return remainder


@pytest.mark.slow
def test_a_wire_is_a_force_over_the_height(of_wire: Remainder) -> None:
    assert [shape.curve.name for shape in of_wire.shapes] == ["force-over-height"]
    assert {attempt.name for attempt in of_wire.attempts} > {"force-over-height"}


@pytest.mark.slow
def test_the_curve_is_the_wire_s_force_within_its_band(of_wire: Remainder) -> None:
    (shape,) = of_wire.shapes
    rig = draw_rig(SEED, "independent")
    truth = -STIFFNESS_N_M3 * np.maximum(shape.at - WIRE_FROM_M, 0.0) ** 3 / (rig.mass_kg * rig.gravity_m_s2)
    off = shape.share - truth
    off -= np.average(off, weights=1.0 / (shape.high - shape.low) ** 2)  # a constant is K_c under another name

    assert np.ptp(truth) > 0.2
    assert np.max(np.abs(off)) < 0.1 * np.ptp(truth)
    slack = shape.at < WIRE_FROM_M
    assert np.ptp(shape.share[slack]) < 0.05 * np.ptp(truth)
    assert np.all((shape.low <= shape.share) & (shape.share <= shape.high))


@pytest.mark.slow
def test_it_predicts_recordings_that_chose_nothing(of_wire: Remainder) -> None:
    improvement = of_wire.improvement

    assert improvement.ci95_ratio[1] < 0.8
    assert improvement.removed > 0.95
    assert improvement.extended_rmse_m < 1.1 * improvement.floor_m
    assert 0.5 < improvement.flexible_rmse_m / improvement.extended_rmse_m < 2.0


@pytest.fixture(scope="module")
def clean_campaign(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Criterion, Fit]]:
    """A campaign with nothing hidden, and the paper's model of it."""
    folder: Path = tmp_path_factory.mktemp("nothing")
    with paper_model(folder, {}) as (criterion, fit):
        yield folder, criterion, fit


@pytest.mark.slow
def test_nothing_hidden_has_no_curve(clean_campaign: tuple[Path, Criterion, Fit]) -> None:
    folder, criterion, fit = clean_campaign

    remainder = modelled(folder, criterion, fit, candidates=True)

    assert remainder is not None
    assert not remainder.shapes
    assert not remainder.proposed
    assert remainder.fit is fit
    assert remainder.improvement.extended_rmse_m == remainder.improvement.causes_rmse_m


@pytest.mark.slow
def test_what_the_budget_does_not_pay_is_not_begun(
    clean_campaign: tuple[Path, Criterion, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, criterion, fit = clean_campaign
    monkeypatch.setattr(criterion, "whole", Budget(1e6))

    with pytest.raises(Spent):
        scores(criterion, fit, curve.CURVES)


def test_the_page_s_splines_are_the_kernel_s() -> None:
    k = np.random.default_rng(2).normal(size=curve.COEFFICIENTS)
    c = neutral()
    c[curve.PULL_OVER_I + 1] = 2.0
    c[curve.PULL_OVER_I + 2 : curve.PULL_OVER_I + 2 + len(k)] = k
    at = np.linspace(0.0, 2.0, 33)[:-1]

    expected = [curve.value(c, curve.PULL_OVER_I, float(i)) for i in at]

    np.testing.assert_allclose(basis(at / 2.0) @ k, expected, atol=1e-12)


@pytest.mark.slow
def test_the_regression_has_a_window_for_flights_alone(clean_campaign: tuple[Path, Criterion, Fit]) -> None:
    campaign = load(clean_campaign[0])
    fit, judge = (gather(read_campaign(campaign, use=use), campaign.plant) for use in ("fit", "judge"))

    errors = flexible_errors(fit, judge, 10, seed=0)
    again = flexible_errors(fit, judge, 10, seed=0)

    np.testing.assert_array_equal(errors, again)
    assert errors.shape == (len(judge.series),)
    known = np.isfinite(errors)
    assert 0.5 < known.mean() < 1.0
    spread = judge.series.x[10:] - judge.series.x[:-10]
    assert math.sqrt(float(np.mean(errors[known] ** 2))) < 0.2 * float(spread[known[10:]].std())
