"""The plant card on the page of a rig's model: what is shown, what is judged, and who may state it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from gateway.views.hmi.model.plant import FIELDS, judged, plant_card, stated_ms
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED
from tests.harness.gateway.bus_peers import PlayedGateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, served

HEAVY = pb.Plant(name="heavy", mass_kg=20e-3, travel_m=12e-3, x_max_m=16e-3, gravity_m_s2=9.81, ball_diameter_m=17e-3)
TYPED = {"name": "heavy", "mass_g": "20", "diameter_mm": "17", "travel_mm": "12", "x_max_mm": "16", "gravity": "9.81"}
BOARD = pb.Parameters(x_ref_max_m=10.9e-3)


def answers(typed: Mapping[str, str], parameters: pb.Parameters | None = BOARD) -> dict[str, tuple[str, bool]]:
    judgement: dict[str, Any] = judged(typed, parameters)
    return {answer["field"]: (answer["text"], answer["error"]) for answer in judgement["answers"]}


def test_the_page_has_the_values_in_mm_and_g_and_sends_si() -> None:
    card = plant_card(pb.PlantCard(plant=HEAVY, who="ana", stated_ns=10**18), "rig")

    assert (card["name"], card["who"], card["emulated"], card["stated_ms"]) == ("heavy", "ana", False, 10**12)
    assert dict(card["fields"]) == {name: text for name, text in TYPED.items() if name in FIELDS}
    sent = judged({"name": card["name"], **card["fields"]}, BOARD)
    plant = sent["command"]["set_plant"]["plant"]
    assert sent["answers"] == []
    assert {name: plant[name] for name in plant if name != "name"} == pytest.approx(
        {field.name: value for field, value in HEAVY.ListFields() if field.name != "name"}
    )


def test_a_card_that_nobody_stated_and_one_that_has_not_come_are_told_apart() -> None:
    nobody, absent = plant_card(pb.PlantCard(), "rig"), plant_card(None, "rig")

    assert (nobody["stated_ms"], absent["stated_ms"], stated_ms(pb.PlantCard())) == (0, -1, 0)
    assert (nobody["name"], nobody["fields"]["mass_g"], nobody["fields"]["gravity"]) == ("rig", "", "9.81")
    assert plant_card(pb.PlantCard(plant=HEAVY, who=EMULATED, stated_ns=1), "rig")["emulated"]


@pytest.mark.parametrize(
    ("changed", "field", "message", "error"),
    [
        ({"mass_g": "0.008"}, "mass_g", "0.008 g is outside 0.1 g .. 2 kg. You may mean 8 g", True),
        ({"mass_g": "8,28"}, "mass_g", "a steel ball of 17 mm weighs 20.19 g", False),
        ({"mass_g": "heavy"}, "mass_g", "This is not a number.", True),
        ({"mass_g": "inf"}, "mass_g", "This is not a number.", True),
        ({"travel_mm": ""}, "travel_mm", "This value is needed.", True),
        ({"travel_mm": "5.7", "x_max_mm": ""}, "travel_mm", "whose references end at 10.9 mm", False),
        ({"x_max_mm": "11"}, "x_max_mm", "11 mm lies within the travel of 12 mm", True),
        ({"gravity": "10"}, "gravity", "is not measured anywhere on Earth", False),
        ({"name": " "}, "name", "Give a name", True),
        ({"name": "r" * 65}, "name", "up to 64 characters", True),
    ],
)
def test_what_is_wrong_stands_beside_its_field(changed: dict[str, str], field: str, message: str, error: bool) -> None:
    text, is_error = answers(TYPED | changed)[field]

    assert message in text
    assert is_error is error


def test_nothing_typed_is_answered_and_raises_nothing() -> None:
    assert {field for field, (_, error) in answers({}, None).items() if error} == {"mass_g", "travel_mm", "name"}


def send_card(gateway: PlayedGateway, viewer: Page, words: str, card: pb.PlantCard) -> str:
    """The page, once it has the words."""

    def look() -> str:
        gateway.send("plant", card)
        page: str = viewer.open("/model/rig")
        return page if words in page else ""

    return wait_for(look, words)


@pytest.mark.slow
def test_everybody_sees_the_card_and_an_engineer_states_it(tmp_path: Path) -> None:
    with served(tmp_path, {}) as (gateway, port):
        viewer, engineer = Page(port), Page(port)
        viewer.log_in("vic")
        engineer.log_in("ana")
        nobody = send_card(gateway, viewer, "nobody stated the plant", pb.PlantCard())
        page_text = send_card(gateway, viewer, "Stated by ana", pb.PlantCard(plant=HEAVY, who="ana", stated_ns=10**18))
        able = engineer.open("/model/rig")
        gateway.commands.clear()
        state = {"set_plant": judged(TYPED, None)["command"]["set_plant"]}
        refused = viewer.post("/api/rig/command", state)
        accepted = engineer.post("/api/rig/command", state)

    assert "8.28 g, 5.7 mm" in nobody
    assert "<td>mass of the ball, g</td><td>20</td>" in page_text
    assert "data-plant" not in page_text
    assert "data-plant" in able
    assert refused.status_code == 403
    assert accepted.json()["accepted"]
    assert [command.set_plant.plant.mass_kg for _, command in gateway.commands] == [20e-3]
