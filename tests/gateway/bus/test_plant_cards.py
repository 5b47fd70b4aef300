"""The plant card of a rig: stated over the bus or by a file, published, kept over a restart, and logged."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gateway.bus.plant_cards import CONFIGURATION, configured_card
from gateway.config import GatewayConfig
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED
from protocol.campaign import load_plant
from protocol.errors import ConfigError
from protocol.log.reader import read
from tests.harness.gateway.gateway_peers import (
    Bus,
    ScriptedBoard,
    client,
    gateway_config,
    running,
    wait_for,
)

HEAVY = pb.Plant(name="heavy", mass_kg=20e-3, travel_m=6e-3, x_max_m=9e-3, gravity_m_s2=9.81, ball_diameter_m=17e-3)
FILE = '[plant]\nname = "filed"\nmass_kg = 30e-3\ntravel_m = 6e-3\n'


@contextmanager
def served(config: GatewayConfig) -> Iterator[Bus]:
    with running(config), client(config.zenoh.listen[0]) as bus:
        wait_for(bus.states, "first sample")
        yield bus


def card(bus: Bus, *, who: str) -> pb.PlantCard:
    """The newest card, once it is of this sender."""

    def newest() -> pb.PlantCard | None:
        made: list[pb.PlantCard] = bus.messages["rig/plant"][-1:]
        return made[0] if made and made[0].who == who else None

    return wait_for(newest, f"card of {who!r}")


def stated(**changed: Any) -> pb.SetPlant:
    plant = pb.Plant()
    plant.CopyFrom(HEAVY)
    for name, value in changed.items():
        setattr(plant, name, value)
    return pb.SetPlant(plant=plant)


def test_a_card_is_published_kept_over_a_restart_and_logged(tmp_path: Path) -> None:
    with ScriptedBoard() as board:
        config = gateway_config(board.url, log=tmp_path)
        with served(config) as bus:
            nobody = card(bus, who="")
            assert bus.command("plant", set_plant=stated()).accepted
            made = card(bus, who="test")
            event = bus.await_event("plant-stated")
        with served(config) as bus:
            again = card(bus, who="test")

    assert not nobody.HasField("plant")
    assert made.plant == again.plant == HEAVY
    assert abs(made.stated_ns - again.stated_ns) < 1000
    assert event.text == ("test: a ball of 20 g (17 mm), travel 6 mm, x_max 9 mm, g 9.81 m/s2; before: not stated")
    saved = load_plant(tmp_path / "plants" / "rig.toml")
    assert (saved.name, saved.mass_kg, saved.ball_diameter_m, saved.assumed) == ("heavy", 20e-3, 17e-3, False)
    first = min(tmp_path.glob("*.mcap"))
    logged = [record.message for record in read(first, topics=["plant", "command/record", "event"])]
    assert any(isinstance(m, pb.PlantCard) and m.plant == HEAVY for m in logged)
    assert any(isinstance(m, pb.CommandRecord) and m.command.set_plant.plant == HEAVY for m in logged)
    assert any(isinstance(m, pb.Event) and m.name == "plant-stated" for m in logged)


def test_what_is_impossible_is_refused_and_what_is_unusual_is_asked_about(tmp_path: Path) -> None:
    with ScriptedBoard() as board, served(gateway_config(board.url, log=tmp_path)) as bus:
        wait_for(lambda: bus.messages["rig/parameters"], "parameters")
        impossible = bus.command("1", set_plant=stated(mass_kg=20.0))
        unusual = bus.command("2", set_plant=stated(gravity_m_s2=10.0, travel_m=8.9e-3, x_max_m=8.9e-3))
        short_travel = bus.command("3", set_plant=stated(travel_m=5.9e-3))
        nameless = bus.command("4", set_plant=stated(name=""))
        confirmed = stated(gravity_m_s2=10.0)
        confirmed.confirmed = True
        reply = bus.command("5", set_plant=confirmed)

    assert (impossible.reason, impossible.refused_by) == ("implausible", "gateway")
    assert "You may mean 20 g" in impossible.text
    assert (unusual.reason, short_travel.reason, nameless.reason) == ("not-confirmed", "not-confirmed", "malformed")
    assert "10 m/s2 is not measured anywhere on Earth" in unusual.text
    assert "whose references end at 6 mm" in short_travel.text
    assert reply.accepted


def test_the_newest_statement_counts(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(FILE)
    with ScriptedBoard() as board:
        config = gateway_config(board.url, log=tmp_path, plant=str(file))
        os.utime(file, (1e9, 1e9))
        with served(config) as bus:
            configured = card(bus, who=CONFIGURATION)
            assert bus.command("plant", set_plant=stated()).accepted
            card(bus, who="test")
        with served(config) as bus:
            later_command = card(bus, who="test")
        file.touch()
        with served(config) as bus:
            later_file = card(bus, who=CONFIGURATION)
            changed = bus.await_event("plant-stated")

    assert (configured.plant.name, later_command.plant.name, later_file.plant.name) == ("filed", "heavy", "filed")
    assert changed.text.endswith(
        "travel 6 mm, x_max 6 mm, g 9.81 m/s2; before: a ball of 20 g (17 mm), travel 6 mm, x_max 9 mm, g 9.81 m/s2"
    )


def test_a_configured_plant_that_is_impossible_or_assumed_ends_the_start(
    tmp_path: Path,
) -> None:
    (board,) = gateway_config("/dev/null", plant=str(tmp_path / "rig.toml")).boards
    with pytest.raises(ConfigError, match=r"plant of the board rig: .*rig\.toml cannot be read"):
        configured_card(board)
    (tmp_path / "rig.toml").write_text(FILE.replace("30e-3", "30"))
    with pytest.raises(ConfigError, match=r"plant of the board rig: .*mass_kg: 30 kg .* You may mean 30 g"):
        configured_card(board)
    (tmp_path / "rig.toml").write_text(FILE + "assumed = true\n")
    with pytest.raises(ConfigError, match=r"plant of the board rig: .*nobody stated this plant"):
        configured_card(board)

    assert not configured_card(replace(board, plant="")).HasField("plant")


@pytest.mark.parametrize(
    "content", ["[plant\n", *(f'{FILE}[stated]\nwho = "a"\nat_s = {at}\n' for at in (1e300, -1.0))]
)
def test_a_kept_card_that_is_damaged_costs_no_start(content: str, tmp_path: Path) -> None:
    (tmp_path / "plants").mkdir()
    (tmp_path / "plants" / "rig.toml").write_text(content)
    with ScriptedBoard() as board, served(gateway_config(board.url, log=tmp_path)) as bus:
        event = bus.await_event("plant-not-kept")
        assert not card(bus, who="").HasField("plant")

    assert "The kept plant card is not used" in event.text


def test_a_card_that_cannot_be_written_counts_until_the_restart_and_is_told(tmp_path: Path) -> None:
    (tmp_path / "plants").write_text("a file where the folder should be")
    with ScriptedBoard() as board, served(gateway_config(board.url, log=tmp_path)) as bus:
        assert bus.command("plant", set_plant=stated()).accepted
        event = bus.await_event("plant-not-kept")
        card(bus, who="test")

    assert "A restart forgets it" in event.text


@pytest.mark.slow
def test_an_emulated_ce_152_states_its_plant_until_somebody_else_does(tmp_path: Path) -> None:
    with Emulator(tcp=False) as emulator, served(gateway_config(*emulator.urls, log=tmp_path)) as bus:
        emulated = card(bus, who=EMULATED)
        assert bus.command("plant", set_plant=stated()).accepted
        card(bus, who="test")
        wait_for(lambda: len(bus.messages["rig/parameters"]) > 2, "another look at the board")
        assert card(bus, who="test").plant == HEAVY

    assert (emulated.plant.mass_kg, emulated.plant.travel_m) == (8.28e-3, 5.7e-3)
