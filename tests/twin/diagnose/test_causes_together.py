"""Two causes of one size hide each other: each alone explains less than a fifth, together they leave noise."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocol.campaign import load
from tests.twin.diagnose.hidden_campaign import make_campaign
from twin.diagnose import forward
from twin.diagnose import select as search
from twin.diagnose.begin import no_better, start_theta
from twin.diagnose.estimate import climb
from twin.diagnose.evidence import gather
from twin.diagnose.floor import floor_of
from twin.diagnose.likelihood import Criterion
from twin.diagnose.theta import BASE, STOPS
from twin.identify.reading import read_campaign
from twin.model.causes.catalogue import BY_NAME

HIDDEN = {"quadratic-drag": 2.0, "air-gap-offset": 3e-4}
TRIED = tuple(BY_NAME[name] for name in (*HIDDEN, "constant-force"))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_causes_that_hide_each_other_are_taken_together_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the rule of the payoff, which would take the first of these two by itself."""
    monkeypatch.setattr(forward, "PAYS", 1.0)
    make_campaign(tmp_path / "both", effects=HIDDEN, seed=310, plant="independent", quick=True)
    campaign = load(tmp_path / "both")
    records = read_campaign(campaign)
    criterion = Criterion(gather(records, campaign.plant), campaign.plant, 2e-3, workers=1)
    try:
        start = no_better(start_theta(records, campaign.plant), criterion.evidence)
        base = climb(criterion, start, (*BASE, *STOPS))
        floor = floor_of(criterion, base.theta)
        alone = search.select(criterion, base, floor, candidates=TRIED, quick=True, classes=False)
        one = search.select(criterion, base, floor, candidates=(TRIED[1], TRIED[2]), classes=False)
        both = search.select(criterion, base, floor, candidates=TRIED, classes=False)
        right = floor.under(criterion, both.fit.theta)
    finally:
        criterion.close()

    assert alone.causes == []
    assert one.causes == []  # the other is not among the candidates: nothing leaves noise
    assert set(both.causes) == set(HIDDEN)
    assert not right.material(both.fit.loglik)
    assert abs(right.excess(both.fit.loglik)) < 3.0 * right.error * right.readings
    assert both.fit.theta.value("quadratic-drag.c_n_s2_m2") == pytest.approx(2.0, rel=0.05)
    assert both.fit.theta.value("air-gap-offset.d_m") == pytest.approx(3e-4, rel=0.05)
