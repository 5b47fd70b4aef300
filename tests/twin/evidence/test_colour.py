"""The colour of the noise is told from the ball at rest; white noise stays white."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import draw_rig, make_campaign
from tests.harness.diagnose.instruments import Instrument, worse
from twin.evidence.colour import colours_of, expected_gain
from twin.evidence.gather import Evidence, gather
from twin.evidence.noise_levels import Colour
from twin.readers.campaign import read_campaign

SEED = 9044
RIG = draw_rig(SEED, "emulator")
TICK_S = 2e-3


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("colour") / "campaign"
    make_campaign(folder, effects={}, seed=SEED, plant="emulator", quick=True)
    return folder


def evidence_of(folder: Path) -> list[Evidence]:
    campaign = load(folder)
    return [gather(read_campaign(campaign, use=use), campaign.plant) for use in ("fit", "judge")]


@pytest.mark.slow
def test_white_noise_stays_white(campaign: Path) -> None:
    assert colours_of(evidence_of(campaign)) == (None, None, None)


def test_coloured_noise_of_x_is_told_at_rest(campaign: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(campaign, tmp_path / "copy"))
    colour, times = 0.7, 3.0
    worse(folder, "*", x=Instrument(noise=times * RIG.position_noise_m, colour=colour))

    i_c, x, captured = colours_of(evidence_of(folder))

    assert i_c is None
    assert captured is None
    assert x is not None
    assert x.tau_s == pytest.approx(-TICK_S / np.log(colour), rel=0.4)
    assert x.white == pytest.approx(1.0 / (1.0 + times**2), abs=0.1)
    assert x.sigma == pytest.approx(np.hypot(1.0, times) * RIG.position_noise_m, rel=0.2)


def test_a_difference_of_coloured_readings_is_smaller() -> None:
    colour = Colour(tau_s=1e-2, white=0.2, sigma=1.0, readings=1000)

    gain = expected_gain(colour, TICK_S, np.array([1.0, -1.0]))

    assert gain == pytest.approx(0.2 + 0.8 * (1.0 - np.exp(-0.2)))
