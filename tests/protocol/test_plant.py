"""Tests of the data of a plant: refusals, questions, and the values that were probably meant."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import card_plant
from protocol.campaign import parse
from protocol.errors import ConfigError
from protocol.plant import Objection, Plant, in_words, objections, steel_ball_kg

CE152: dict[str, Any] = {
    "mass_kg": 8.28e-3,
    "travel_m": 5.7e-3,
    "x_max_m": 8.138e-3,
    "gravity_m_s2": 9.81,
    "ball_diameter_m": 12.6e-3,
}
RECORDING = '[[recording]]\nfile = "r.csv"\nkind = "free"\nuse = "fit"\n'


def find_objections(**changed: Any) -> dict[str, Objection]:
    highest = changed.pop("highest_reference_m", None)
    values = {key: value for key, value in (CE152 | changed).items() if value is not None}
    return {objection.key: objection for objection in objections(values, highest_reference_m=highest)}


def test_the_published_ball_has_the_weight_of_steel() -> None:
    # Chromium steel, 10 mm: 4.07 to 4.11 g in tables of makers of bearings.
    assert steel_ball_kg(10e-3) == pytest.approx(4.09e-3, rel=0.02)
    assert find_objections() == {}
    assert find_objections(highest_reference_m=5.2e-3) == {}


@pytest.mark.parametrize(
    ("changed", "key", "expected"),
    [
        ({"mass_kg": 8.28}, "mass_kg", "8.28 kg is outside 0.1 g .. 2 kg. You may mean 8.28 g (mass_kg = 0.00828)."),
        ({"mass_kg": 8.28e-6}, "mass_kg", "You may mean 8.28 g"),
        ({"travel_m": 5.7, "x_max_m": 5.7}, "travel_m", "5.7 m is outside 0.1 mm .. 500 mm. You may mean 5.7 mm"),
        ({"x_max_m": 8.138}, "x_max_m", "You may mean 8.138 mm (x_max_m = 0.008138)"),
        ({"ball_diameter_m": 12.6}, "ball_diameter_m", "You may mean 12.6 mm"),
        ({"x_max_m": 5.6e-3}, "x_max_m", "5.6 mm lies within the travel of 5.7 mm. The force (3) is infinite"),
        ({"gravity_m_s2": 981.0}, "gravity_m_s2", "You may mean 9.81 m/s2"),
        ({"gravity_m_s2": -9.81}, "gravity_m_s2", "-9.81 m/s2 is outside"),
        ({"mass_kg": 0.0}, "mass_kg", "0 g is outside"),
    ],
)
def test_what_is_impossible_is_an_error_and_says_what_may_be_meant(
    changed: dict[str, Any], key: str, expected: str
) -> None:
    objection = find_objections(**changed)[key]

    assert objection.is_error
    assert expected in objection.text


@pytest.mark.parametrize(
    ("changed", "key", "expected"),
    [
        ({"mass_kg": 20e-3}, "mass_kg", "20 g does not fit the diameter: a steel ball of 12.6 mm weighs 8.222 g"),
        ({"mass_kg": 1.5, "ball_diameter_m": None}, "mass_kg", "1.5 kg is unusual, 0.5 g .. 200 g are usual. You may"),
        ({"gravity_m_s2": 10.0}, "gravity_m_s2", "10 m/s2 is not measured anywhere on Earth, 9.75 .. 9.84 m/s2 are"),
        ({"gravity_m_s2": 9.74}, "gravity_m_s2", "You may mean 9.81 m/s2, or confirm it"),
        ({"travel_m": 57e-3, "x_max_m": 57e-3}, "travel_m", "57 mm is unusual"),
        (
            {"travel_m": 4e-3, "highest_reference_m": 5.2e-3},
            "travel_m",
            "4 mm does not fit the board, whose references",
        ),
        ({"travel_m": 20e-3, "x_max_m": 20e-3, "highest_reference_m": 5.2e-3}, "travel_m", "end at 5.2 mm"),
    ],
)
def test_what_is_unusual_is_asked_about(changed: dict[str, Any], key: str, expected: str) -> None:
    objection = find_objections(**changed)[key]

    assert not objection.is_error
    assert expected in objection.text


@pytest.mark.parametrize("gravity_m_s2", [9.75, 9.764, 9.81, 9.834, 9.84])
def test_gravity_as_measured_on_earth_is_not_asked_about(gravity_m_s2: float) -> None:
    assert find_objections(gravity_m_s2=gravity_m_s2) == {}


def test_a_heavy_ball_that_is_as_large_is_asked_about_only_for_its_size() -> None:
    large = find_objections(mass_kg=steel_ball_kg(60e-3), ball_diameter_m=60e-3)

    assert set(large) == {"mass_kg", "ball_diameter_m"}
    assert "does not fit" not in large["mass_kg"].problem


@given(st.dictionaries(st.sampled_from([*CE152, "name", "other"]), st.floats() | st.text() | st.none() | st.booleans()))
def test_whatever_is_stated_is_judged_without_an_error_of_ours(values: dict[str, object]) -> None:
    results = objections(values)

    assert len({objection.key for objection in results}) == len(results)
    for objection in results:
        value = values[objection.key]
        assert isinstance(value, float)
        assert math.isfinite(value)


def test_a_file_with_an_impossible_plant_is_refused_and_an_unusual_one_is_read() -> None:
    plant = "[plant]\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\nball_diameter_m = 12.6e-3\n"

    assert parse(plant + "gravity_m_s2 = 10\n" + RECORDING, where="c").plant.gravity_m_s2 == 10.0
    assert parse(plant + RECORDING, where="c").plant.ball_diameter_m == 12.6e-3
    with pytest.raises(ConfigError, match=r"c: plant\.x_max_m: 5 mm lies within the travel of 5\.7 mm"):
        parse(plant + "x_max_m = 5e-3\n" + RECORDING, where="c")
    with pytest.raises(ConfigError, match=r"plant\.ball_diameter_m: 12\.6 m is outside"):
        parse(plant.replace("12.6e-3", "12.6") + RECORDING, where="c")


def test_a_plant_in_words_has_the_units_of_people() -> None:
    assert in_words(Plant(name="rig", **CE152)) == (
        "a ball of 8.28 g (12.6 mm), travel 5.7 mm, x_max 8.138 mm, g 9.81 m/s2"
    )


@pytest.mark.parametrize("value", [0.0, -1e-3, math.nan, math.inf, 1e300])
@pytest.mark.parametrize("key", CE152)
def test_a_card_with_a_plant_that_no_gateway_lets_through_states_none(key: str, value: float) -> None:
    good, bad = (pb.PlantCard(plant=pb.Plant(name="rig", **(CE152 | changed))) for changed in ({}, {key: value}))

    assert card_plant(good) == Plant(name="rig", **CE152)
    assert card_plant(bad) is None
