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
    one = criterion_of(narrow(strong(CAUSE, 0.01), seconds=50.0))
    yield one
    one.close()


@pytest.fixture(scope="module")
def base(criterion: Criterion) -> Fit:
    return approach(criterion, THETA, BASE)


def test_a_part_is_a_fraction_of_the_samples_and_has_none_of_its_own(criterion: Criterion) -> None:
    part = criterion.thinner

    assert part.share == pytest.approx(len(part.evidence.series) / len(criterion.evidence.series))
    assert part.share < 0.4
    assert part.thinner is part


def test_few_samples_are_all_taken() -> None:
    few = criterion_of(narrow(THETA, seconds=2.0))

    assert few.thinner is few
    assert few.share == 1.0
    few.close()


@pytest.mark.slow
def test_the_way_over_a_part_ends_near_the_maximum_of_all(criterion: Criterion, base: Fit) -> None:
    start = strong(CAUSE, 0.001, base.theta)

    near, end = approach(criterion, start, FREE), climb(criterion, start, FREE)

    assert near.loglik == pytest.approx(criterion.value(near.theta), abs=3.0)  # of all samples
    assert end.loglik - near.loglik < 3.0 * near.ahead  # as far as it says
    assert end.loglik - near.loglik < 0.05 * (end.loglik - base.loglik)
    assert climb(criterion, near.theta, FREE).loglik == pytest.approx(end.loglik, abs=0.1)


def test_a_part_scores_as_all_samples_would(criterion: Criterion, base: Fit) -> None:
    """To the scatter of the part: a force that does not change shows in some blocks more than in others."""
    causes = [BY_NAME[CAUSE], BY_NAME["quadratic-drag"]]

    (first, *_), (own, *_) = (screen(one, base.theta, base.free, causes) for one in (criterion, criterion.thinner))

    assert first.cause == own.cause == CAUSE
    assert own.testable
    assert own.gain == pytest.approx(first.gain, rel=0.5)
    assert own.z == pytest.approx(first.z, rel=0.5)
