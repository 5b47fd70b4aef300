"""A cause is not kept if it would not be taken now: the later ones have left it next to nothing."""

from __future__ import annotations

import pytest

from tests.harness.diagnose.simulated_rig import THETA, criterion_of, fitted, narrow, strong
from twin.diagnosis.search import stepwise as select
from twin.diagnosis.search.equivalence import find_classes
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.score_test import probed
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.task import Search
from twin.inference.noise_floor import floor_of
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings

FIRST, LATER = "motional-emf", "actuation-delay"


@pytest.mark.slow
@pytest.mark.parametrize(("strength", "retained"), [(0.15, False), (1.0, True)])
def test_a_minor_effect_beside_a_later_cause_goes_if_noise_remains(strength: float, retained: bool) -> None:
    rig = probed(strong(LATER, 6e-4), BY_NAME[FIRST], strength)
    criterion = criterion_of(narrow(rig, seconds=3.0))
    try:
        base, both = fitted(criterion, THETA), fitted(criterion, rig, FIRST, LATER)
        later_fit = fitted(criterion, strong(LATER, 6e-4), LATER)
        last = Round(scores=(), trials=(), selected=LATER)
        gains = {FIRST: 1e3, LATER: 1e3}
        at_first = Selection(base=base, fit=both, causes=(FIRST, LATER), gains=gains, rounds=(last,))

        task = Search(
            criterion=criterion,
            floor=floor_of(criterion, rig),
            candidates=(BY_NAME["quadratic-drag"],),
            max_candidates=3,
        )
        reduced = select.backward(task, at_first)
        exchanged = find_classes(task, at_first)
    finally:
        criterion.close()

    loss, gained = both.loglik - later_fit.loglik, both.loglik - base.loglik
    assert loss > settings.MIN_GAIN  # no question of chance
    assert (loss > settings.MINOR_SHARE_AT_NOISE * gained) == retained
    assert reduced.causes == ((FIRST, LATER) if retained else (LATER,))
    assert (reduced.fit is both) == retained
    assert exchanged.causes == reduced.causes, "nor is what an exchange has left next to nothing"
