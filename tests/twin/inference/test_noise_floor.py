"""The noise floor is that of the model judged: a right one lacks nothing under its own, and not under another's."""

from __future__ import annotations

import math
from dataclasses import replace

from tests.harness.diagnose.known_diagnosis import QUIET, steps
from tests.harness.diagnose.simulated_rig import PLANT, TICK_S, strong
from twin.evidence.gather import gather
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.inference.theta import FLOORS


def test_a_right_model_lacks_nothing_under_its_own_floor_alone() -> None:
    rig = strong("air-gap-offset", 2.4e-3, replace(QUIET, process_a_m_s2=FLOORS["process_a_m_s2"]))
    measured = Floor(sigma_i_c_a=rig.sigma_i_c_a, sigma_x_m=rig.sigma_x_m, measured=True)
    criterion = Criterion(gather([steps(rig, seed=3, seconds=40.0)], PLANT), PLANT, TICK_S, workers=1)
    try:
        loglik = criterion.value(rig)
        right, other = (
            measured.under(criterion, rig),
            measured.under(criterion, rig.without("air-gap-offset", criterion.plant)),
        )
    finally:
        criterion.close()

    chance = 4.0 * math.sqrt(0.5 * right.readings)  # four standard deviations of half a chi-squared
    assert abs(right.excess(loglik)) < chance
    assert abs(other.excess(loglik)) > chance
