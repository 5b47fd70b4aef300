"""A campaign has the plant of the rig's card, and freezes it; without one it says that the plant is assumed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import board51
from gateway.config import LimitsConfig
from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from tests.harness.gateway.campaign_line import Line, emulated_line, words
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.heavy_rig import DRAGGED_RIG, HEAVY, TRUTH

LIMITS = LimitsConfig(x_ref_min_m=0.7e-3, x_ref_max_m=10.9e-3, x_ref_step_m=5.2e-3, x_ref_slew_m_s=42e-3)


def state(line: Line, plant: pb.Plant = HEAVY) -> None:
    count = len(line.bus.messages["rig/plant"])
    assert line.bus.command(plant.name, set_plant=pb.SetPlant(plant=plant)).accepted
    wait_for(lambda: len(line.bus.messages["rig/plant"]) > count, "the card")


def run(line: Line, folder: Path, *more: str) -> int:
    return board51.main(words(line.endpoint, folder, *more))


@pytest.mark.slow
def test_nobody_s_plant_is_assumed_and_said_and_a_card_ends_that(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, folder = tmp_path / "rig.toml", tmp_path / "c"
    rig.write_text(DRAGGED_RIG)
    with emulated_line(tmp_path, rig=str(rig), limits=LIMITS) as line:
        assert run(line, folder, "--experiment", "lift-off", "--quick") == 0
        assumed, error_output = load(folder).plant, capsys.readouterr().err
        state(line)
        assert run(line, folder, "--experiment", "rest", "--quick") == 0
        stated = load(folder).plant
        light = pb.Plant()
        light.CopyFrom(HEAVY)
        light.name, light.mass_kg = "light", 10e-3
        state(line, light)
        assert run(line, folder, "--experiment", "amplifier-steps-judge", "--quick") == 0
        line.assert_parked(x_ref_m=6e-3)

    assert (assumed.mass_kg, assumed.assumed) == (8.28e-3, True)
    assert "nobody stated the plant: a published CE 152 is assumed" in error_output
    assert (stated.name, stated.mass_kg, stated.travel_m, stated.x_max_m) == ("heavy", 20e-3, 12e-3, 16e-3)
    assert not stated.assumed
    assert load(folder).plant == stated, "a folder keeps the card with which it was flown"


@pytest.mark.slow
def test_with_its_card_another_ball_is_identified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, folder, model = tmp_path / "rig.toml", tmp_path / "c", tmp_path / "model.json"
    rig.write_text(DRAGGED_RIG)
    # The default noise happens to be less white than usual (p = 0.03 to 0.15 in four flights): near the alarm at 0.001.
    with emulated_line(tmp_path, rig=str(rig), limits=LIMITS, seed=120) as line:
        state(line)
        assert run(line, folder, "--quick") == 0
    capsys.readouterr()

    assert board51.main(["identify", str(folder), "--out", str(model)]) == 0

    captured = capsys.readouterr()
    assert not [text for text in captured.out.splitlines() + captured.err.splitlines() if text.startswith("!")]
    parameters = json.loads(model.read_text())["parameters"]
    for name, true in TRUTH.items():
        parameter = parameters[name]
        assert parameter["verdict"] == "identified", name
        assert abs(parameter["value"] - true) < 4 * parameter["std"], (name, parameter)
