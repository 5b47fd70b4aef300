"""Many tests on one page: a right model fails in any of them as seldom as the page says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.harness.diagnose.simulated_rig import TICK_S
from twin.diagnosis.residuals.regimes import blocks_of, error_bins
from twin.estimation.family import FAMILY_LEVEL, holm


def test_a_test_that_just_misses_among_many_is_no_finding() -> None:
    assert holm([0.04, 0.5, 0.7]) == [False, False, False]
    assert holm([0.04]) == [True]


def test_one_strong_finding_does_not_hide_the_next() -> None:
    """The second is compared with level / 2, not with level / 3: Holm's gain over Bonferroni."""
    assert holm([0.02, 1e-6, 0.9]) == [True, True, False]


def test_a_missing_test_counts_for_nothing() -> None:
    assert holm([math.nan, 0.03]) == [False, True]


@pytest.mark.slow
def test_two_equally_good_models_are_seldom_told_apart_in_any_of_fifty_groups() -> None:
    rng = np.random.default_rng(4)
    n, groups, trials = 25_000, 50, 60
    labels = (np.arange(n) // (n // groups)).astype(np.int64)
    names = [str(group) for group in range(groups)]
    # Half a second is 31 samples of this interval: 16 blocks in each group.
    blocks = blocks_of(np.zeros(n, np.int32), 8.0 * TICK_S, 0)

    failed = 0
    for _ in range(trials):
        bins = error_bins(rng.standard_normal((2, n)), labels, names, labels.astype(float), blocks)
        assert len(bins) == groups
        failed += any(holm([error_bin.chance for error_bin in bins]))

    # Few blocks make the tail a little heavier: twice the level, and 3 standard errors of the trials.
    limit = 2.0 * FAMILY_LEVEL
    assert failed / trials <= limit + 3.0 * math.sqrt(limit * (1.0 - limit) / trials)


def test_a_level_of_its_own_can_be_given() -> None:
    assert holm([0.04, 0.5], level=0.1) == [True, False]
    assert FAMILY_LEVEL == pytest.approx(0.05)
