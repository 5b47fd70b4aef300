"""Pairs of parameters that trade off, against fits with one of the two held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.harness.diagnose.simulated_rig import PLANT, criterion_of, narrow, strong
from twin.diagnosis.report.trade_offs import trade_off_cards, trade_off_sentences
from twin.inference.fisher_scoring import Fit, climb, with_covariance
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, coordinates_of
from twin.inference.trade_offs import END_DROP, TradeOff, trade_offs

CAUSE = "air-gap-offset"
FREE = (*BASE, *coordinates_of(CAUSE))
(D,) = coordinates_of(CAUSE)


@pytest.fixture(scope="module")
def criterion() -> Iterator[Criterion]:
    instance = criterion_of(narrow(strong(CAUSE, 1e-3), seconds=10.0))
    yield instance
    instance.close()


@pytest.fixture(scope="module")
def fit(criterion: Criterion) -> Fit:
    return with_covariance(criterion, climb(criterion, strong(CAUSE, 1e-3), FREE))


@pytest.fixture(scope="module")
def pair(criterion: Criterion, fit: Fit) -> TradeOff:
    """K_c and the gap: at few heights, a wider gap is a stronger magnet."""
    return next(entry for entry in trade_offs(criterion, fit) if set(entry.names) == {"K_c", D})


def test_a_fit_with_one_held_moves_the_other_as_the_pair_says(criterion: Criterion, fit: Fit, pair: TradeOff) -> None:
    k = pair.names.index(D)
    held = fit.theta.having(D, pair.values[k] + 1.96 * pair.stds[k])

    refit = climb(criterion, held, BASE)

    shift = refit.theta.K_c - fit.theta.K_c
    assert shift == pytest.approx(pair.correlation * 1.96 * pair.stds[1 - k], rel=0.1)
    assert criterion.value(fit.theta) - criterion.value(refit.theta) == pytest.approx(END_DROP, rel=0.15)
    assert refit.std("K_c", PLANT) * pair.narrowing == pytest.approx(pair.stds[1 - k], rel=0.1)


def test_the_ends_of_the_long_axis_are_as_unlikely_as_the_ellipse_says(pair: TradeOff) -> None:
    assert pair.drops == pytest.approx((END_DROP, END_DROP), rel=0.15)
    assert pair.parabolic


def test_the_words_name_the_combination(pair: TradeOff) -> None:
    text = " ".join(trade_off_sentences(pair))

    assert "K_c and d of air-gap-offset" in text
    assert "larger by" in text
    assert "these data determine" in text
    assert text.count("e-") == 0  # no number that a reader has to decode


def test_a_parameter_without_a_partner_is_not_in_a_pair(criterion: Criterion, fit: Fit) -> None:
    """K_A and T_A follow from i_c alone, so nothing of the ball takes their place."""
    assert not {"K_A", "T_A"} & {name for entry in trade_offs(criterion, fit) for name in entry.names}


def test_a_noise_level_that_the_recordings_do_not_show_and_a_pair_that_is_one_do_no_harm(
    criterion: Criterion, fit: Fit, pair: TradeOff
) -> None:
    covariance = fit.covariance.copy()
    i, j, unknown = (fit.free.index(name) for name in (*pair.names, "process_a_m_s2"))
    covariance[i, j] = covariance[j, i] = np.sqrt(covariance[i, i] * covariance[j, j])
    covariance[unknown, unknown] = 1e12
    covariance[unknown, [i, j]] = covariance[[i, j], unknown] = 0.9e6 * np.sqrt(covariance[[i, j], [i, j]])

    first, *_ = trade_offs(criterion, replace(fit, covariance=covariance))

    assert first.names == pair.names
    assert np.isfinite(first.contour).all()
    assert np.isfinite(first.narrowing)


def test_a_limit_that_may_be_beyond_all_numbers_is_drawn_as_far_as_it_goes(criterion: Criterion, fit: Fit) -> None:
    limit = coordinates_of("current-limit")[0]
    free, covariance = ("K_A", limit), np.array([[1e-4, 0.99e-2], [0.99e-2, 1.0]])
    wide = replace(fit, theta=fit.theta.having(limit, 1.2), free=free, covariance=covariance)

    (pair,) = trade_offs(criterion, wide)
    (card,) = trade_off_cards((pair,))

    assert len(pair.contour) > 10
    assert np.isfinite(pair.contour).all()
    assert "inf" not in " ".join(card["sentences"])


def test_relative_changes_of_a_value_that_may_be_zero_are_not_spoken_of(criterion: Criterion, fit: Fit) -> None:
    """A shape is often 0, or near it."""
    wide = fit.covariance.copy()
    k = fit.free.index(D)
    wide[k] *= 1e4
    wide[:, k] *= 1e4
    at_zero = replace(fit, theta=fit.theta.having(D, 0.0))

    for doubtful in (replace(fit, covariance=wide), at_zero):
        (first, *_) = [pair for pair in trade_offs(criterion, doubtful) if D in pair.names]

        assert first.weights is None
        assert not any("relative changes" in sentence for sentence in trade_off_sentences(first))


@pytest.mark.slow
def test_a_climb_without_hope_of_its_goal_ends_early_and_one_with_hope_as_without_a_goal(
    criterion: Criterion, fit: Fit
) -> None:
    start = strong(CAUSE, 1e-4)
    whole = climb(criterion, start, FREE)

    hopeless = climb(criterion, start, FREE, goal=whole.loglik + 1e4)
    hopeful = climb(criterion, start, FREE, goal=whole.loglik - 1.0)

    assert hopeless.passes < whole.passes
    assert hopeless.loglik < whole.loglik
    assert hopeful.theta == whole.theta
