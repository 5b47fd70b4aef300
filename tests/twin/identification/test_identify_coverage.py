"""Do the 95 % intervals contain the truth as often as they say?  On campaigns of random rigs on the emulated board."""

from __future__ import annotations

import numpy as np
import pytest

from tests.harness.twin.emulated_campaign import TRUTHS, campaign_of, random_rig, run_campaign, truth
from twin.identification.pipeline import identify_records

CAMPAIGNS = 40


@pytest.mark.sample
def test_intervals_contain_the_truth_in_90_to_99_percent_and_bias_is_below_the_spread() -> None:
    hits: dict[str, list[bool]] = {name: [] for name in TRUTHS}
    z: dict[str, list[float]] = {name: [] for name in TRUTHS}
    relative: dict[str, list[float]] = {name: [] for name in TRUTHS}

    for seed in range(1000, 1000 + CAMPAIGNS):
        rig = random_rig(np.random.default_rng(seed))
        result = identify_records(campaign_of(rig), run_campaign(rig, seed=seed, flight_s=12.0))
        for name, true in truth(rig).items():
            parameter = result.model.parameters[name]
            assert parameter.ci95 is not None
            assert parameter.std is not None
            hits[name].append(parameter.ci95[0] <= true <= parameter.ci95[1])
            z[name].append((parameter.value - true) / parameter.std)
            relative[name].append(parameter.value / true - 1.0)

    for name in TRUTHS:
        print(
            f"{name:4} inside {100 * np.mean(hits[name]):5.1f} %  z {np.mean(z[name]):+.2f} +- {np.std(z[name]):.2f} "
            f" relative bias {np.mean(relative[name]):+.1e}  rms {np.sqrt(np.mean(np.square(relative[name]))):.1e}"
        )
    together = np.mean([hits[name] for name in TRUTHS])
    # 160 intervals at 95 %: one standard deviation is 1.7 %; of 40 per parameter, 3.4 %.
    assert 0.90 <= together <= 0.99
    for name in TRUTHS:
        assert np.mean(hits[name]) >= 0.95 - 3 * 0.034
        assert abs(np.mean(z[name])) < 4.0 / np.sqrt(CAMPAIGNS)
