"""Tests of the sensor noise, of the worth of a cause for the prediction of x, and of the start of a confounder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import Campaign, load
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.diagnosis.search.candidate_starts import start_of, substitute_start
from twin.diagnosis.search.prediction_benefit import error_reduction
from twin.diagnosis.search.score_test import screen
from twin.estimation.innovations import RESTS_LOW, USE_X
from twin.evidence.gather import gather
from twin.evidence.sensor_noise import sensor_noise
from twin.inference.fisher_scoring import climb
from twin.inference.initial_guess import start_theta, with_noise_bounds
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, STOPS, Theta
from twin.model.causes.catalogue import BY_NAME
from twin.readers.campaign import read_campaign


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder: Path = tmp_path_factory.mktemp("campaign") / "null"
    make_campaign(folder, effects={}, seed=2024, plant="independent", quick=True)
    return load(folder)


@pytest.fixture(scope="module")
def criterion(campaign: Campaign) -> Iterator[Criterion]:
    made = Criterion(gather(read_campaign(campaign), campaign.plant), campaign.plant, 2e-3, workers=1)
    yield made
    made.close()


@pytest.fixture(scope="module")
def fitted(campaign: Campaign, criterion: Criterion) -> Theta:
    start = with_noise_bounds(start_theta(read_campaign(campaign), campaign.plant), criterion.evidence)
    return climb(criterion, start, (*BASE, *STOPS)).theta


def test_a_current_that_settles_is_no_noise_of_rest(campaign: Campaign) -> None:
    records = read_campaign(campaign)
    quiet_i, quiet_x = sensor_noise(gather(records, campaign.plant))
    index = next(n for n, record in enumerate(records) if record.kind == "free" and record.has("x"))
    decays = records[index].i_c.copy()
    decays[400:460] += np.exp(-np.arange(60) / 10.0)
    records[index] = replace(records[index], i_c=decays)

    sigma_i, sigma_x = sensor_noise(gather(records, campaign.plant))

    assert quiet_i is not None
    assert sigma_i == pytest.approx(quiet_i, rel=0.03)
    assert sigma_x == quiet_x


def test_a_ball_that_hovers_beside_its_stop_does_not_lie_there(campaign: Campaign) -> None:
    """Shaken at lift-off one hung 0.3 mm above the stop for 70 ms: as a reading of the stop it hid two causes."""
    records = read_campaign(campaign)
    index = next(n for n, record in enumerate(records) if record.kind == "sawtooth")
    ramp = records[index]
    rests = np.flatnonzero(gather(records, campaign.plant).series.flags & RESTS_LOW != 0)
    x = ramp.x.copy()
    # Not the whole rest: 40 samples of it, and a jump to and fro that ends the rests beside them.
    lies = np.flatnonzero(np.abs(x) < 5e-5)
    middle = int(lies[len(lies) // 2])
    x[middle - 30 : middle - 25], x[middle + 45 : middle + 50] = 2e-3, 2e-3
    x[middle - 25 : middle + 45] += 0.3e-3
    records[index] = replace(ramp, x=x)

    evidence = gather(records, campaign.plant)

    rows = np.flatnonzero(evidence.series.recording == index)
    flags = evidence.series.flags[rows]
    assert len(rests) > 0
    assert (flags[middle - 25 : middle + 45] & (RESTS_LOW | USE_X) == 0).all()
    assert (flags[lies[0] + 10 : middle - 60] & RESTS_LOW != 0).sum() > 100


def test_the_fit_begins_with_sensors_that_are_not_too_good(campaign: Campaign, criterion: Criterion) -> None:
    """A noise level below what it may have would be a place that no step leaves."""
    start = start_theta(read_campaign(campaign), campaign.plant)

    theta = with_noise_bounds(replace(start, sigma_i_c_a=1e-6, sigma_x_m=1e-9), criterion.evidence)

    assert theta.sigma_i_c_a == theta.min_sigma_i_c_a > 1e-4
    assert theta.sigma_x_m == theta.min_sigma_x_m > 1e-7


def test_what_is_removed_of_the_prediction_error(criterion: Criterion, fitted: Theta) -> None:
    wrong = replace(fitted, K_c=0.97 * fitted.K_c)

    assert error_reduction(criterion, wrong, fitted) > 0.3
    assert error_reduction(criterion, fitted, wrong) < -0.3
    assert error_reduction(criterion, fitted, fitted) == 0.0


def test_a_confounder_is_tried_at_the_size_of_the_cause_whose_place_it_takes(campaign: Campaign, fitted: Theta) -> None:
    """A delay is right within microseconds or nowhere: no grid of sizes meets it."""
    cause, confounder, size = BY_NAME["actuation-delay"], BY_NAME["sampling-delay"], 2e-3
    flights = [record for record in read_campaign(campaign) if record.kind == "closed-loop"]
    evidence = gather(flights, campaign.plant)
    shifted = replace(evidence, series=replace(evidence.series, u=np.roll(evidence.series.u, -1)))
    delayed = Criterion(shifted, campaign.plant, 2e-3, workers=1)
    try:
        start = substitute_start(delayed, fitted.having("actuation-delay.delay_s", size), cause, confounder)
        values = delayed.values([fitted.having("sampling-delay.delay_s", delay_s) for delay_s in (0.8 * size, size)])
    finally:
        delayed.close()

    assert values[1] > values[0] + 1000.0
    assert start.value("sampling-delay.delay_s") == size
    assert start.value("actuation-delay.delay_s") == 0.0


def test_a_ball_beyond_the_range_of_its_sensor_shows_no_stop(campaign: Campaign) -> None:
    """Readings that are all the converter's last value say "below", not "at": a stop there would become a gap."""
    records, offset_m = read_campaign(campaign), 0.6e-3
    raised = [replace(record, x=record.x + offset_m) for record in records]
    hidden = [replace(record, x=np.maximum(record.x - offset_m, 0.0)) for record in records]

    visible, unseen = gather(raised, campaign.plant), gather(hidden, campaign.plant)

    assert visible.low_m == pytest.approx(offset_m, abs=5e-5)
    assert unseen.low_m is None


def test_noise_that_the_end_of_a_range_cuts_off_is_not_measured(campaign: Campaign) -> None:
    """Half of it would pass for a quieter sensor, and any model for one that leaves more than noise."""
    records = read_campaign(campaign)
    whole_i, whole_x = sensor_noise(gather(records, campaign.plant))
    assert whole_x is not None
    end = 0.2 * whole_x  # of the range: three in five readings of a ball at rest lie there
    cut = [replace(record, x=np.maximum(record.x, end)) for record in records]

    sigma_i, sigma_x = sensor_noise(gather(cut, campaign.plant))

    assert sigma_i == whole_i
    assert sigma_x is None  # the ball rests too shortly at the upper stop
    assert gather(cut, campaign.plant).low_m is not None


def test_the_current_of_a_ball_that_rests_unseen_tells_its_noise(campaign: Campaign) -> None:
    """Both stops beyond the range: nothing else in the campaign says how good the current sensor is."""
    records = read_campaign(campaign)
    visible_i, _ = sensor_noise(gather(records, campaign.plant))
    ends = 0.3e-3, campaign.plant.travel_m - 0.3e-3
    blinded = [replace(record, x=np.clip(record.x, *ends)) for record in records]

    evidence = gather(blinded, campaign.plant)

    assert (evidence.low_m, evidence.high_m) == (None, None)
    assert sensor_noise(evidence)[0] == pytest.approx(visible_i, rel=0.05)


def test_a_sensor_that_reads_too_small_is_tried_where_it_does(campaign: Campaign) -> None:
    """A part of the linear step puts the upper stop off by dozens of standard errors, unless the stop moves with it."""
    gain = 0.91
    shrunk = [replace(record, x=gain * record.x, x_ref=gain * record.x_ref) for record in read_campaign(campaign)]
    criterion = Criterion(gather(shrunk, campaign.plant), campaign.plant, 2e-3, workers=1)
    try:
        base = climb(criterion, start_theta(shrunk, campaign.plant), (*BASE, *STOPS))
        (score,) = screen(criterion, base.theta, base.free, [BY_NAME["position-sensor-gain"]])
        value = criterion.value(start_of(criterion, base.theta, score))
    finally:
        criterion.close()

    assert value > base.loglik
