"""Tails and quantiles are those of `scipy.stats`, at the ends of the range, too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from twin import distributions as ours

PROBABILITIES = [1e-300, 1e-12, 0.025, 0.5, 0.975, 1.0 - 1e-12]


@pytest.mark.parametrize("value", [-40.0, -1.0, 0.0, 1e-9, 0.7, 5.0, 300.0, 1e5])
@pytest.mark.parametrize("freedom", [1, 2, 25, 7.3, 1e4])
def test_tails(value: float, freedom: float) -> None:
    assert ours.normal_above(value) == stats.norm.sf(value)
    assert ours.student_above(value, freedom) == stats.t.sf(value, freedom)
    assert ours.chi2_above(max(value, 0.0), freedom) == stats.chi2.sf(max(value, 0.0), freedom)
    values = np.array([value, 1.0, 2.0])
    assert np.array_equal(ours.chi2_below(values, freedom), stats.chi2.cdf(values, freedom))
    ratios = np.maximum(values, 0.0)
    assert np.array_equal(ours.fisher_above(ratios, 2.0, freedom), stats.f.sf(ratios, 2.0, freedom))


@pytest.mark.parametrize("probability", PROBABILITIES)
@pytest.mark.parametrize("freedom", [1, 2, 25, 7.3, 1e4])
def test_quantiles(probability: float, freedom: float) -> None:
    assert ours.normal_exceeded(probability) == stats.norm.isf(probability)
    assert ours.student_quantile(probability, freedom) == stats.t.ppf(probability, freedom)
    assert ours.chi2_exceeded(probability, freedom) == stats.chi2.isf(probability, freedom)
    assert ours.chi2_quantile(probability, freedom) == stats.chi2.ppf(probability, freedom)
    assert ours.fisher_quantile(probability, 1, freedom) == stats.f.ppf(probability, 1, freedom)


@pytest.mark.parametrize("share", [0.0, 1e-6, 0.3, 0.9, 1.0 - 1e-12])
def test_the_tail_of_a_share(share: float) -> None:
    with np.errstate(divide="ignore"):
        assert ours.log_beta_above(share, 3, 120) == pytest.approx(stats.beta.logsf(share, 3, 120), rel=1e-12)
