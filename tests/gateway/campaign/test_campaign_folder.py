"""The folder of a campaign: a damaged run.json, what is left to do, and a plant that nobody stated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gateway.board.emulated import CE152
from gateway.campaign.folder import ASSUMED, Folder, Retained, controller_of, identity_of
from gateway.campaign.subscriber import Recorded
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Plant, load
from protocol.errors import DataError, UsageError
from protocol.experiments import MENU

NAME = MENU[0].name
RECORDING: dict[str, Any] = {"bytes": 3, "seconds": 1.5, "attempts": 1, "plan": {"seed": 1}}
WHOLE: dict[str, Any] = {"format": 1, "identity": {"plant": {}}, "lift_off_v": None, "recordings": {NAME: RECORDING}}


def test_a_list_of_recordings_is_read(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps(WHOLE))

    assert Folder(tmp_path).retained[NAME].seconds == 1.5


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"format": 2}, "format = 2 is not 1"),
        ({"recordings": None}, "recordings = None is not a table"),
        ({"lift_off_v": "3"}, "lift_off_v = '3' is not a finite number"),
        ({"recordings": {NAME: {**RECORDING, "bytes": "3"}}}, f"recordings.{NAME}.bytes = '3' is not a whole number"),
        ({"recordings": {"[key]": {**RECORDING, "said": [1]}}}, "recordings.[key].said 1 = 1 is not text"),
        ({"recordings": {NAME: {**RECORDING, "said": "x"}}}, f"recordings.{NAME}.said = 'x' is not a list of texts"),
    ],
)
def test_what_is_damaged_is_named(tmp_path: Path, change: dict[str, Any], error: str) -> None:
    (tmp_path / "run.json").write_text(json.dumps({**WHOLE, **change}))

    with pytest.raises(DataError) as refused:
        Folder(tmp_path)

    assert (
        str(refused.value) == f"{tmp_path / 'run.json'}: {error}. Give a new folder; the recordings here stay readable."
    )


RIG = pb.Parameters(firmware="1.0 at89", gains=[0.49, 1700.0, 17.7, -17600.0], x_0_m=2.85e-3)
STATED = Plant(name="my-rig", mass_kg=9e-3, travel_m=6e-3, x_max_m=6e-3, gravity_m_s2=9.81)


def recorded(path: Path, plant: Plant, parameters: pb.Parameters = RIG) -> Folder:
    """A folder with the first two experiments begun, and one of them recorded."""
    folder = Folder(path)
    folder.claim(identity_of("rig", parameters, plant))
    folder.begin([experiment.name for experiment in MENU[:2]], quick=True)
    once = Retained(bytes=0, seconds=1.0, attempts=1, plan={})
    folder.keep(MENU[0], Recorded(messages=[], states=[], captures=[], events=[], commands=[]), once, None)
    return folder


def test_a_folder_knows_what_an_interrupted_run_has_left_to_do(tmp_path: Path) -> None:
    recorded(tmp_path, STATED)

    again = Folder(tmp_path)
    assert (again.left, again.quick) == ([MENU[1].name], True)
    again.begin([MENU[1].name, MENU[2].name], quick=False)
    again.settle([MENU[1].name])
    assert (again.left, again.quick) == ([MENU[2].name], False)


def test_a_plant_that_nobody_stated_is_marked_and_may_be_stated_later(tmp_path: Path) -> None:
    recorded(tmp_path, ASSUMED)
    assert load(tmp_path).plant.assumed
    assert "nobody stated it" in (tmp_path / "campaign.toml").read_text()
    assert Folder(tmp_path).plant == ASSUMED, "the same command goes on with it"

    folder = Folder(tmp_path)
    folder.claim(identity_of("rig", RIG, STATED))
    folder.save(controller_of(RIG))

    assert load(tmp_path).plant == STATED
    with pytest.raises(UsageError, match="of another plant: name was my-rig"):
        Folder(tmp_path).claim(identity_of("rig", RIG, CE152))


def test_a_plant_that_was_corrected_by_hand_is_kept(tmp_path: Path) -> None:
    recorded(tmp_path, ASSUMED)
    file = tmp_path / "campaign.toml"
    text = file.read_text().replace("assumed = true\n", "").replace("mass_kg = 0.00828", "mass_kg = 0.0091")
    file.write_text(text)

    folder = Folder(tmp_path)
    assert folder.plant is not None
    folder.claim(identity_of("rig", RIG, folder.plant))
    folder.save(controller_of(RIG))

    plant = load(tmp_path).plant
    assert (plant.mass_kg, plant.assumed) == (9.1e-3, False)
