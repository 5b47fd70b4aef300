"""A loop of force over current on a rig that shares no equation with the twin."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose


@pytest.mark.sample
@pytest.mark.parametrize(
    ("kind", "seed"), [("force-hysteresis", 51), ("force-loop", 52)], ids=["play", "Bouc-Wen, n = 2"]
)
def test_it_is_named_and_predicted_and_has_its_width(kind: str, seed: int, tmp_path: Path) -> None:
    half_width_a = 0.03
    make_campaign(tmp_path, effects={}, seed=seed, plant="independent", outside={kind: half_width_a})

    diagnosis = diagnose(load(tmp_path / "campaign.toml"), Options(quick=True))

    assert diagnosis.verdict == "causes-found"
    assert [cause.name for cause in diagnosis.causes] == ["magnetic-hysteresis"]
    assert diagnosis.causes[0].parameters["i_h_a"].value == pytest.approx(half_width_a, rel=0.1)
    assert diagnosis.gain is not None
    assert diagnosis.gain.removed > 0.98
