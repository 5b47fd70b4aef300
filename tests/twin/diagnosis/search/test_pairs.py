"""Two causes are tried together after a refused step only while more is missing than is explained."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.harness.diagnose.simulated_rig import THETA, criterion_of, fitted, narrow, strong
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.pairs import join
from twin.diagnosis.search.score_test import probed, screen
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.task import Search
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.model.causes.catalogue import BY_NAME

LARGE, SMALL, OTHER = "actuation-delay", "position-sensor-gain", "quadratic-drag"
Rig = tuple[Criterion, Fit, Fit]


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    """The likelihood of a rig with a large and a small cause, and its fits without either and with the large one."""
    hidden = probed(strong(LARGE, 6e-4), BY_NAME[SMALL], 1.01)
    criterion = criterion_of(narrow(hidden, seconds=3.0))
    yield criterion, fitted(criterion, THETA), fitted(criterion, strong(LARGE, 6e-4), LARGE)
    criterion.close()


@pytest.mark.parametrize("has_large", [True, False])
def test_pairs_are_tried_only_while_more_is_missing_than_explained(rig: Rig, has_large: bool) -> None:
    criterion, base, with_large = rig
    fit, causes = (with_large, (LARGE,)) if has_large else (base, ())
    candidates = [BY_NAME[name] for name in (LARGE, SMALL, OTHER) if name not in causes]
    refused = Round(
        scores=tuple(screen(criterion, fit.theta, fit.free, candidates)),
        trials=(),
        selected="",
        refusal="small share",
    )
    floor = floor_of(criterion, base.theta)
    gained, missing = fit.loglik - base.loglik, floor.under(criterion, fit.theta).excess(fit.loglik)
    assert floor.under(criterion, fit.theta).material(fit.loglik), "more than noise is missing in both cases"
    assert (missing < gained) == has_large
    before = criterion.evaluations

    task = Search(criterion=criterion, floor=floor, candidates=candidates, max_candidates=3)
    selection = Selection(base=base, fit=fit, causes=causes, gains=dict.fromkeys(causes, gained), rounds=(refused,))
    joined = join(task, selection)

    tried = criterion.evaluations - before > 1  # the floor takes one
    assert tried == (not has_large)
    if has_large:
        assert joined is selection
