"""A fit that goes most of its way over a part of the samples ends where it ends over all of them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.harness.diagnose.simulated_rig import THETA, criterion_of, narrow, strong
from twin.diagnosis.search.score_test import screen
from twin.inference.fisher_scoring import Fit, approach, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, coordinates_of
from twin.model.causes.catalogue import BY_NAME

CAUSE = "constant-force"
FREE = (*BASE, *coordinates_of(CAUSE))


@pytest.fixture(scope="module")
def criterion() -> Iterator[Criterion]:
    instance = criterion_of(narrow(strong(CAUSE, 0.01), seconds=50.0))
    yield instance
    instance.close()


@pytest.fixture(scope="module")
def base(criterion: Criterion) -> Fit:
    return approach(criterion, THETA, BASE)


def test_a_part_is_a_fraction_of_the_samples_and_has_none_of_its_own(criterion: Criterion) -> None:
    part = criterion.thinner

    assert part.share == pytest.approx(len(part.evidence.series) / len(criterion.evidence.series))
    assert part.share < 0.4
    assert part.thinner is part


def test_few_samples_are_all_taken() -> None:
    small = criterion_of(narrow(THETA, seconds=2.0))

    assert small.thinner is small
    assert small.share == 1.0
    small.close()


@pytest.mark.slow
def test_the_way_over_a_part_ends_near_the_maximum_of_all(criterion: Criterion, base: Fit) -> None:
    start = strong(CAUSE, 0.001, base.theta)

    approached, end = approach(criterion, start, FREE), climb(criterion, start, FREE)

    assert approached.loglik == pytest.approx(criterion.value(approached.theta), abs=3.0)  # of all samples
    assert end.loglik - approached.loglik < 3.0 * approached.ahead  # as far as it says
    assert end.loglik - approached.loglik < 0.05 * (end.loglik - base.loglik)
    assert climb(criterion, approached.theta, FREE).loglik == pytest.approx(end.loglik, abs=0.1)


@pytest.mark.slow
def test_a_slow_effect_is_not_fitted_to_blocks_that_each_begin_anew() -> None:
    """A block is 0.2 s long: over them the time of a drift ran to the end of its range, and no fit came back."""
    cause = "amplifier-gain-drift"
    criterion = criterion_of(narrow(strong(cause, 0.03), seconds=50.0))
    try:
        base = approach(criterion, THETA, BASE)
        fit = approach(criterion, strong(cause, 0.02, base.theta), (*BASE, *coordinates_of(cause)))
    finally:
        criterion.close()

    assert criterion.thinner is not criterion
    assert fit.theta.value(f"{cause}.tau_s") == pytest.approx(30.0, rel=1.0)
    assert fit.loglik > base.loglik + 1000.0


def test_a_part_scores_as_all_samples_would(criterion: Criterion, base: Fit) -> None:
    """To the scatter of the part: a force that does not change shows in some blocks more than in others."""
    causes = [BY_NAME[CAUSE], BY_NAME["quadratic-drag"]]

    (first, *_), (part, *_) = (screen(item, base.theta, base.free, causes) for item in (criterion, criterion.thinner))

    assert first.cause == part.cause == CAUSE
    assert part.testable
    assert part.gain == pytest.approx(first.gain, rel=0.5)
    assert part.z == pytest.approx(first.z, rel=0.5)
