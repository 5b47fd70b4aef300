"""A name falls where something unknown explains more in its place, and stays where it is right."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import PlantName, make_campaign
from tests.twin.diagnosis.remainder.test_remainder import paper_model
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.remainder.curve_fits import roughly_fitted, scores
from twin.diagnosis.remainder.rivals import Rival, best_curve, rivals_of
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stepwise import select
from twin.diagnosis.search.task import Search
from twin.inference.fisher_scoring import climb
from twin.inference.noise_floor import floor_of
from twin.inference.theta import coordinates_of
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.curve import CURVES, FREE_FORM_OF

SEED = 23


def rivals(
    folder: Path,
    cause: str,
    *,
    plant: PlantName,
    effects: Mapping[str, float] | None = None,
    outside: Mapping[str, float] | None = None,
    seed: int = SEED,
) -> Mapping[str, Rival]:
    """The rivals of a cause that is fitted to a campaign with this effect."""
    with paper_model(folder, outside or {}, effects=effects, seed=seed, plant=plant) as (criterion, base):
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


def test_each_curve_acts_on_what_causes_of_the_catalogue_act_on() -> None:
    assert set(FREE_FORM_OF) == {curve.name for curve in CURVES}
    assert {quantity for quantities in FREE_FORM_OF.values() for quantity in quantities} <= {
        cause.acts_on for cause in CATALOGUE
    }


@pytest.mark.slow
def test_a_law_of_the_force_for_a_bent_sensor_falls(tmp_path: Path) -> None:
    """Beside its curve nothing could be learnt about the exponent, but the curve is at another place of the loop."""
    hidden = {"position-sensor-nonlinearity": 1e-4}
    results = rivals(tmp_path, "force-exponent", plant="emulator", effects=hidden, seed=12859)

    assert results["force-exponent"].curve.name == "sensor-over-height"


@pytest.mark.slow
def test_a_law_of_the_magnet_s_force_for_a_spring_falls(tmp_path: Path) -> None:
    """A force without the magnet is at another place, although the ball hovers where both are equal."""
    results = rivals(tmp_path, "force-exponent", plant="independent", outside={"wire-spring": 1.18e6}, seed=12923)

    assert results["force-exponent"].curve.name == "force-over-height"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("outside", "name", "curve"),
    [
        ({"squeeze-film": 0.5}, "magnetic-hysteresis", "drag-over-height"),
        ({"current-bow": 0.08}, "current-sensor-offset", "reading-over-current"),
    ],
)
def test_a_name_falls_for_a_drag_near_the_stop_and_for_a_current_sensor_that_bends(
    outside: dict[str, float], name: str, curve: str, tmp_path: Path
) -> None:
    results = rivals(tmp_path, name, plant="independent", outside=outside, seed=13301)

    assert results[name].curve.name == curve


@pytest.mark.slow
def test_a_fit_of_a_curve_begins_where_the_linear_step_has_not_gone_astray(tmp_path: Path) -> None:
    with paper_model(tmp_path, {"spring-of-a-cable": 4.0}, seed=SEED, plant="independent") as (criterion, base):
        curves = scores(criterion, base, CURVES)
        (usual,) = (score for score in curves if score.curve.name == "sensor-over-height")
        astray = replace(usual, step=tuple(10.0 * change for change in usual.step))
        gains = [roughly_fitted(criterion, base, score).loglik - base.loglik for score in (usual, astray)]

    assert min(gains) > 1000.0


@contextmanager
def asked(
    folder: Path,
    names: tuple[str, ...],
    *,
    effects: Mapping[str, float],
    outside: Mapping[str, float],
    plant: PlantName = "independent",
) -> Iterator[tuple[Search, Selection, list[str]]]:
    """A search for these names that knows the best curve, what it selects, and the lines that it reports."""
    lines: list[str] = []
    with paper_model(folder, outside, effects=effects, seed=SEED, plant=plant) as (criterion, base):
        task = Search(
            criterion=criterion,
            floor=floor_of(criterion, base.theta),
            candidates=[BY_NAME[name] for name in names],
            quick=True,
            curve=partial(best_curve, criterion, base),
            report=lines.append,
        )
        yield task, select(task, base), lines


@pytest.mark.slow
def test_where_a_curve_explains_more_than_names_can_no_further_one_is_looked_for(tmp_path: Path) -> None:
    imitations = ("position-sensor-nonlinearity", "force-exponent", "residual-magnetism", "core-saturation")
    with asked(tmp_path, imitations, effects={}, outside={"spring-of-a-cable": 8.0}) as (task, selection, lines):
        rivals = rivals_of(task.criterion, selection)

    assert any("no further one is looked for" in line for line in lines)
    assert len(selection.causes) == 2
    assert set(rivals) == set(selection.causes)


@pytest.mark.slow
def test_right_names_are_looked_for_although_a_curve_explains_one_of_them(tmp_path: Path) -> None:
    hidden = {"air-gap-offset": 3e-4, "quadratic-drag": 2.0, "amplifier-dead-zone": 0.05}
    with asked(tmp_path, tuple(hidden), effects=hidden, outside={}) as (_, selection, lines):
        assert set(selection.causes) == set(hidden)

    assert not any("no further one is looked for" in line for line in lines)


@pytest.mark.slow
def test_what_a_curve_explains_is_not_examined_as_a_change_in_the_middle(tmp_path: Path) -> None:
    lines: list[str] = []
    make_campaign(tmp_path, effects={"quadratic-drag": 3.0}, seed=SEED, plant="independent", quick=True)

    diagnosis = diagnose(load(tmp_path), Options(without=("quadratic-drag",), say=lines.append))

    assert diagnosis.verdict == "unknown-cause"
    assert diagnosis.remainder is not None
    assert [shape.curve.name for shape in diagnosis.remainder.shapes] == ["force-over-speed"]
    assert not any("did something change" in line for line in lines)


@pytest.mark.slow
def test_a_name_that_alone_explains_nearly_all_holds_without_the_one_that_corrects_its_form(tmp_path: Path) -> None:
    """A dead zone by another formula: beside an offset neither explains much that the other does not."""
    names = ("amplifier-dead-zone", "amplifier-offset")
    with asked(tmp_path, names, effects={"dead-zone-quadratic": 0.27}, outside={}, plant="textbook") as (*_, lines):
        pass

    assert any(line.startswith("amplifier-dead-zone alone explains nearly all") for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness_n_m", "count"), [(4.0, 1), (6.0, 2)])
def test_names_that_imitate_a_spring_fall_to_its_curve_alone_and_together(
    tmp_path: Path, stiffness_n_m: float, count: int
) -> None:
    """They overlap in both; of the softer spring one explains nine tenths."""
    names = ("position-sensor-nonlinearity", "residual-magnetism")
    outside = {"spring-of-a-cable": stiffness_n_m}
    with asked(tmp_path, names, effects={}, outside=outside) as (task, selection, _):
        rivals = rivals_of(task.criterion, selection)

    assert len(selection.causes) == count
    assert set(rivals) == set(selection.causes)
