"""A line in the spectrum of the prediction errors, measured as a force."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.diagnose.known_diagnosis import QUIET, steps
from tests.twin.diagnose.simulated_rig import PLANT, TICK_S, strong
from twin.diagnose.evidence import gather
from twin.diagnose.likelihood import Criterion
from twin.diagnose.periodic import AMPLITUDE, CAUSE, FREQUENCY, find_line

FORCE_N, FREQUENCY_HZ = 2e-3, 7.3


def test_a_line_is_the_same_after_the_phases_of_another_were_taken_over() -> None:
    """The search asks again in every round; by then the recordings' clocks are shifted for what it found before."""
    rig = strong(CAUSE.name, FORCE_N, QUIET).having(FREQUENCY, FREQUENCY_HZ)
    records = [steps(rig, seed=seed, seconds=20.0) for seed in (3, 4)]
    criterion = Criterion(gather(records, PLANT), PLANT, TICK_S, workers=1)
    try:
        first = find_line(criterion, QUIET)
        assert first is not None
        criterion.shift_s = first.shift_s
        again = find_line(criterion, QUIET)
        found = QUIET.having(AMPLITUDE, first.amplitude_n).having(FREQUENCY, first.frequency_hz)
        gain = criterion.value(found) - criterion.value(QUIET)
    finally:
        criterion.close()

    assert again is not None
    assert (again.amplitude_n, again.gain) == (first.amplitude_n, first.gain)
    np.testing.assert_array_equal(again.shift_s, first.shift_s)
    assert first.frequency_hz == pytest.approx(FREQUENCY_HZ, abs=0.01)
    assert first.amplitude_n == pytest.approx(FORCE_N, rel=0.05)
    assert gain == pytest.approx(first.gain, rel=0.1)
