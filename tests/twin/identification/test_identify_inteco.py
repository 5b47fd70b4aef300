"""A real rig: the public INTECO recordings, as far as what is known of it from others can judge us."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from protocol.campaign import Campaign, load
from twin.evidence.dead_time import delayed
from twin.identification.delays import input_delay
from twin.identification.horizon import Horizon, error_at
from twin.identification.pipeline import identify
from twin.identification.result import Identification
from twin.readers.campaign import read_campaign

ROOT = Path(__file__).parents[3]
DATA = Path(os.environ.get("BOARD51_DATA", ROOT.parent / "shared" / "data"))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "inteco-mls2em").is_dir(), reason="recordings not found; set BOARD51_DATA")
def test_one_model_of_the_inteco_rig_and_what_is_wrong_with_it() -> None:
    campaign = load(ROOT / "twin" / "campaigns" / "inteco.toml")

    result = identify(campaign, data=DATA)

    assert result.usable
    assert 1.0 / result.model.parameters["K_A"].value == pytest.approx(4.17, rel=0.01)  # ohm, as its authors measured
    assert result.shape is not None
    assert not result.shape.first_order
    assert result.force is not None
    assert result.force.shift_m == pytest.approx(2.07e-3, abs=2 * 0.52e-3)
    assert result.model.parameters["b"].verdict == "not-identifiable"
    delayed_names = {usage.name for usage in result.usages if usage.input_delay == 1}
    assert len([name for name in delayed_names if "/cl_" in name]) == 3
    errors = _on_judges(campaign, result)
    assert len(errors) == 3
    assert all(error.rmse_m < 35e-6 for error in errors.values())  # 2 ms: two sigma of the sensor


def _on_judges(campaign: Campaign, result: Identification) -> dict[str, Horizon]:
    """Errors on each flight that is kept for judging; a late input is taken out of them as it was for fitting."""
    rows = {}
    for record in read_campaign(campaign, use="judge", data=DATA):
        if result.fit is None or record.kind not in ("closed-loop", "prbs", "free"):
            continue
        shifted = delayed(record, input_delay(record, campaign.plant))
        error = error_at(2e-3, [shifted], campaign.plant, result.fit.theta, result.tick_s)
        assert error is not None
        rows[record.name] = error
    return rows
