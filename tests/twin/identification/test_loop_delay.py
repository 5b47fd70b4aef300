"""A loop that acts late by a part of a sample: b has no interval that it may miss."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.harness.diagnose.hidden_campaign import PlantName, make_campaign
from twin import identify


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 704])
def test_beside_a_delay_b_has_no_interval_but_its_value_with_the_delay(seed: int, tmp_path: Path) -> None:
    make_campaign(tmp_path, effects={"actuation-delay": 2.6e-4}, seed=seed, plant="emulator", quick=True)

    result = identify(tmp_path)

    b = result.model.parameters["b"]
    assert (b.ci95, b.std, b.verdict) == (None, None, "not-identifiable")
    (warning,) = [line for line in result.warnings if "ms late" in line]
    assert "acted about 0.26 ms late" in warning
    assert "board51 diagnose" in warning


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "seed"), [("emulator", 5), ("independent", 6)])
def test_without_one_the_interval_stays(plant: PlantName, seed: int, tmp_path: Path) -> None:
    make_campaign(tmp_path, effects={}, seed=seed, plant=plant, quick=True)

    result = identify(tmp_path)

    assert result.model.parameters["b"].verdict == "identified"
    assert not any("ms late" in line for line in result.warnings)
