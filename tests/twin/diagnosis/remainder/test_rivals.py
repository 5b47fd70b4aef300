"""A name falls where something unknown explains more in its place, and stays where it is right."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.harness.diagnose.hidden_campaign import PlantName
from tests.twin.diagnosis.remainder.test_remainder import paper_model
from twin.diagnosis.remainder.rivals import Rival, rivals_of
from twin.diagnosis.search.state import Selection
from twin.inference.fisher_scoring import climb
from twin.inference.theta import coordinates_of
from twin.model.causes.catalogue import BY_NAME

SEED = 23


def rivals(
    folder: Path,
    cause: str,
    *,
    plant: PlantName,
    effects: Mapping[str, float] | None = None,
    outside: Mapping[str, float] | None = None,
) -> Mapping[str, Rival]:
    """The rivals of a cause that is fitted to a campaign with this effect."""
    with paper_model(folder, outside or {}, effects=effects, seed=SEED, plant=plant) as (criterion, base):
        strength = BY_NAME[cause].strength
        begin = base.theta.having(f"{cause}.{strength.name}", strength.probes[0])
        fit = climb(criterion, begin, (*base.free, *coordinates_of(cause)))
        assert fit.loglik > base.loglik + 10.0, "the cause explains something"
        return rivals_of(criterion, Selection(base=base, fit=fit, causes=(cause,)))


@pytest.mark.slow
def test_a_sensor_error_for_a_spring_falls(tmp_path: Path) -> None:
    results = rivals(tmp_path, "position-sensor-nonlinearity", plant="independent", outside={"spring-of-a-cable": 4.0})

    rival = results["position-sensor-nonlinearity"]
    assert rival.curve.name == "force-over-height"
    assert rival.lead > 100.0
    assert rival.is_sole


@pytest.mark.slow
def test_a_right_name_stays(tmp_path: Path) -> None:
    assert rivals(tmp_path, "quadratic-drag", plant="emulator", effects={"quadratic-drag": 1.0}) == {}


@pytest.mark.slow
def test_a_right_effect_by_another_formula_stays(tmp_path: Path) -> None:
    """A polynomial of the gap below i^2: its free form explains a little more than an exponent."""
    assert rivals(tmp_path, "force-exponent", plant="textbook", effects={"gap-polynomial": 0.6}) == {}
