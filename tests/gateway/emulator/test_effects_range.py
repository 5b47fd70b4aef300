"""Each effect is absent at its neutral value and possible in its range; beyond it, it is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest

from gateway.emulator.plant.constants import CE152
from gateway.emulator.plant.effects import EFFECTS, check, listing, parse
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.errors import UsageError


def journey(effects: Mapping[str, float]) -> list[tuple[float, ...]]:
    """Readings and truth over lift-off, a knock at the top, a fall and rebounds."""
    plant = EmulatedPlant(effects=effects, seed=1)
    readings: list[tuple[float, ...]] = []
    for u in (3.6, 5.0, 1.5, 0.0, 4.0):
        for _ in range(20):
            plant.advance(u, 0.002)
            readings.append((*plant.sense(), plant.i_c_a, plant.x_m, plant.v_m_s, plant.drop_sample()))
    return readings


@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_neutral_value_an_effect_is_exactly_absent(name: str) -> None:
    assert journey({name: EFFECTS[name].neutral}) == journey({})


@pytest.mark.parametrize("name", EFFECTS)
def test_at_the_ends_of_its_range_an_effect_leaves_a_possible_rig(name: str) -> None:
    effect = EFFECTS[name]
    for value in (effect.low, effect.high):
        for *_, i_c_a, x_m, v_m_s, _drop in journey({name: value}):
            assert 0.0 <= i_c_a <= CE152.current_max_a
            assert 0.0 <= x_m <= CE152.travel_m
            assert math.isfinite(v_m_s)


def test_all_effects_together_leave_a_possible_rig() -> None:
    for *_, i_c_a, x_m, v_m_s, _drop in journey({name: effect.medium for name, effect in EFFECTS.items()}):
        assert 0.0 <= i_c_a <= EFFECTS["current-limit"].medium
        assert 0.0 <= x_m <= CE152.travel_m
        assert math.isfinite(v_m_s)


def test_sensing_effects_do_not_move_the_ball() -> None:
    sensing = {name: effect.medium for name, effect in EFFECTS.items() if effect.family in {"sensing", "timing"}}

    assert [row[2:5] for row in journey(sensing)] == [row[2:5] for row in journey({})]


@pytest.mark.parametrize("name", EFFECTS)
def test_strengths_grow_from_weak_to_strong_within_the_range(name: str) -> None:
    effect = EFFECTS[name]
    reference = effect.neutral if math.isfinite(effect.neutral) else math.inf

    grades = (effect.weak, effect.medium, effect.strong)
    distances = [abs(value - reference) if math.isfinite(reference) else 1.0 / value for value in grades]

    assert distances == sorted(distances)
    assert all(effect.low <= value <= effect.high for value in grades)
    if effect.signed:
        assert effect.low <= 2.0 * effect.neutral - effect.strong <= effect.high


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("outside", ["low", "high", "nan"])
def test_a_strength_out_of_range_is_refused_with_the_range(name: str, outside: str) -> None:
    effect = EFFECTS[name]
    value = {"low": effect.low - 0.01, "high": effect.high * 1.01, "nan": math.nan}[outside]

    with pytest.raises(UsageError, match=f"{name}.*{effect.low:g} .. {effect.high:g}"):
        EmulatedPlant(effects={name: value})


def test_an_unknown_effect_is_refused_with_the_names() -> None:
    with pytest.raises(UsageError, match=r"'quadratic-drug'.*quadratic-drag"):
        EmulatedPlant(effects={"quadratic-drug": 1.0})


def test_a_gap_that_closes_is_refused_on_a_rig_with_less_room() -> None:
    with pytest.raises(UsageError, match="air-gap-offset"):
        EmulatedPlant(replace(CE152, coil_plane_above_stop_m=1e-3), {"air-gap-offset": -1e-3})


@pytest.mark.parametrize(
    ("text", "expected"),
    [("quadratic-drag=1.5", 1.5), ("quadratic-drag = strong", 4.0), ("current-limit=1.2", 1.2)],
)
def test_an_argument_is_a_name_and_a_number_or_a_grade(text: str, expected: float) -> None:
    assert parse(text) == (text.split("=")[0].strip(), expected)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("quadratic-drag", "no value"),
        ("quadratic-drag=", "no value"),
        ("quadratic-drag=much", "'much' is not a number"),
        ("quadratic-drag=-1", "out of range"),
        ("drag=1", "no effect 'drag'"),
        ("", "no effect ''"),
    ],
)
def test_a_wrong_argument_says_what_is_wrong(text: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        parse(text)


def test_the_listing_has_every_effect_with_its_unit() -> None:
    text = listing()

    for effect in EFFECTS.values():
        line = next(line for line in text.splitlines() if f" {effect.name} " in line)
        assert effect.unit in line
        assert effect.description in line


def test_check_fills_in_what_is_absent() -> None:
    strengths = check({"quadratic-drag": 1})

    assert strengths["quadratic-drag"] == 1.0
    assert set(strengths) == set(EFFECTS)
    assert all(value == EFFECTS[name].neutral for name, value in strengths.items() if name != "quadratic-drag")
