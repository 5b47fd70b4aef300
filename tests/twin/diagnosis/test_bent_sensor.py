"""A sensor that is bent: any shape that is right at both stops, read and undone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.campaign import Campaign, load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.known_diagnosis import QUIET
from twin.diagnosis.pipeline import diagnose, tick_of
from twin.evidence.gather import gather
from twin.inference.likelihood import Criterion
from twin.inference.theta import STOPS, derivative_step, moved
from twin.model.causes.catalogue import neutral
from twin.model.causes.position_sensor_nonlinearity import BOW, CAUSE, FULLNESS, SKEW
from twin.model.extended import Base, position_of_reading, position_reading
from twin.readers.campaign import read_campaign

RIG = Base(K_A=0.3, T_A=0.3e-3, K_c=6e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
BOW_M = 2e-4


@given(
    bow_m=st.floats(-4e-4, 4e-4), skew=st.floats(-1.0, 1.0), fullness=st.floats(-0.5, 0.5), share=st.floats(0.0, 1.0)
)
def test_a_reading_is_undone_and_the_stops_are_right(bow_m: float, skew: float, fullness: float, share: float) -> None:
    c = neutral()
    c[BOW], c[SKEW], c[FULLNESS] = bow_m, skew, fullness
    x = share * RIG.travel_m

    assert position_of_reading(RIG, c, position_reading(RIG, c, x, 0.5), 0.5) == pytest.approx(x, abs=1e-9)
    assert position_reading(RIG, c, 0.0, 0.5) == 0.0
    assert position_reading(RIG, c, RIG.travel_m, 0.5) == pytest.approx(RIG.travel_m, abs=1e-15)
    middle = position_reading(RIG, c, 0.5 * RIG.travel_m, 0.5) - 0.5 * RIG.travel_m
    assert middle == pytest.approx(bow_m * (1.0 - skew**2), abs=1e-15)  # an S is right there


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Provide a campaign of the second plant, whose sensor is no polynomial: half a sine."""
    folder = tmp_path_factory.mktemp("bent")
    make_campaign(folder, effects={CAUSE.name: BOW_M}, seed=4, plant="independent")
    return load(folder / "campaign.toml")


@pytest.mark.slow
def test_the_derivative_by_the_place_of_a_stop_is_the_difference(campaign: Campaign) -> None:
    """Through a bent sensor with another gain, which shows a move of the stop other than it is."""
    plant, records = campaign.plant, read_campaign(campaign)
    bent = replace(QUIET, causes=((f"{CAUSE.name}.bow_m", BOW_M), ("position-sensor-gain.gain", 1.03)))
    criterion = Criterion(gather(records, plant), plant, tick_of(records), workers=1)
    try:
        base, derivatives = criterion.derivatives(bent, STOPS)
        for name, derivative in zip(STOPS, derivatives, strict=True):
            step = derivative_step(bent, name, plant)
            difference = (criterion.outputs(moved(bent, name, step, plant)) - base) / step
            assert np.nanmax(np.abs(derivative)) > 1e-6
            np.testing.assert_allclose(derivative, difference, rtol=0.0, atol=1e-8)
    finally:
        criterion.close()


@pytest.mark.sample
def test_half_a_sine_is_found_as_a_bow_of_that_height_and_nothing_else(campaign: Campaign) -> None:
    diagnosis = diagnose(campaign)

    assert (diagnosis.verdict, [finding.name for finding in diagnosis.causes]) == ("causes-found", [CAUSE.name])
    assert diagnosis.causes[0].parameters["bow_m"].value == pytest.approx(BOW_M, abs=3e-6)
