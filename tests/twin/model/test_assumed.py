"""A plant that nobody stated: what rests on it is marked wherever it is shown."""

from __future__ import annotations

from dataclasses import replace

import pytest

from twin.api.functions import design
from twin.live.folder import plant_of
from twin.live.source import LiveData
from twin.model.assumed import assumption, assumption_warning, mark, rests_on_plant
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Model, model_text, parse_model

BALL = "for an assumed ball of 8.28 g and travel of 5.7 mm"


def assumed() -> Model:
    return replace(Model.load("ce152"), plant=replace(Model.load("ce152").plant, assumed=True))


def test_a_stated_plant_needs_no_word() -> None:
    plant = Model.load("ce152").plant

    assert (assumption(plant), assumption_warning(plant)) == ("", "")
    assert mark(Model.load("ce152").parameters, plant) == Model.load("ce152").parameters


def test_k_c_and_b_say_for_which_ball_they_hold_and_how_to_state_it() -> None:
    model = assumed()

    marked = mark(model.parameters, model.plant)

    assert [name for name, parameter in marked.items() if BALL in parameter.method] == ["K_c", "b"]
    assert BALL in assumption_warning(model.plant)
    assert "assumed = true" in assumption_warning(model.plant)
    assert "--plant FILE" in assumption_warning(model.plant)


@pytest.mark.parametrize(
    ("cause", "rests"),
    [
        ("quadratic-drag", True),  # N, scales with the mass
        ("air-gap-offset", True),  # counted from x_max
        ("motional-emf", True),  # a function of the gap
        ("position-sensor-gain", True),  # known by the stops
        ("amplifier-dead-zone", False),
        ("current-sensor-offset", False),
        ("actuation-delay", False),
        ("lost-samples", False),
    ],
)
def test_a_cause_rests_on_mass_or_travel_or_not(cause: str, rests: bool) -> None:
    assert rests_on_plant(BY_NAME[cause]) is rests


def test_a_model_file_keeps_the_mark() -> None:
    assert parse_model(model_text(assumed()), where="a test").plant.assumed
    assert not parse_model(model_text(Model.load("ce152")), where="a test").plant.assumed


def test_a_design_on_an_assumed_plant_warns() -> None:
    assert any(BALL in warning for warning in design(assumed()).warnings)
    assert not any("assumed ball" in warning for warning in design(Model.load("ce152")).warnings)


@pytest.mark.parametrize("model_json", ["", model_text(Model.load("ce152"))])
def test_a_live_twin_on_the_nominal_model_states_no_plant(model_json: str) -> None:
    live_data = LiveData(model_json=model_json)

    assert plant_of(live_data).assumed


def test_a_live_twin_on_another_model_states_its_plant() -> None:
    custom = replace(Model.load("ce152"), plant=replace(Model.load("ce152").plant, mass_kg=5e-3))
    live_data = LiveData(model_json=model_text(custom))

    assert plant_of(live_data) == custom.plant
