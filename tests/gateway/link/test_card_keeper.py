"""A plant card belongs to the board for which it was stated."""

from __future__ import annotations

import pytest

from gateway.link.card_keeper import CardKeeper
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED
from tests.harness.gateway.gateway_peers import Collector
from tests.harness.gateway.heavy_rig import HEAVY

OF_FILE = pb.PlantCard(plant=HEAVY, who="ana", stated_ns=5)
CE152, CUSTOM_RIG, REAL = (1, "1.2 emulated"), (1, "1.2 emul-own"), (7, "1.0 at89c51")


class ObservedKeeper:
    """A keeper, and what it has published."""

    def __init__(self, card: pb.PlantCard) -> None:
        self.sink = Collector()
        self.keeper = CardKeeper(self.sink)
        self.keeper.card = card

    def after(self, *boards: tuple[int, str]) -> pb.PlantCard:
        for n, (board_id, firmware) in enumerate(boards):
            self.keeper.board_is(board_id, firmware, 100 + n)
        return self.keeper.card

    @property
    def events(self) -> list[str]:
        return [event.name for event in self.sink.messages["event"]]


def test_a_card_of_a_file_takes_the_first_board_that_comes() -> None:
    observed = ObservedKeeper(OF_FILE)

    card = observed.after(REAL, REAL)

    assert (card.plant, card.who, card.stated_ns, card.board) == (HEAVY, "ana", 5, "7 at89c51")
    assert len(observed.sink.messages["plant"]) == 1


@pytest.mark.parametrize("firmware", ["1.1 at89c51", "2.0 at89c51"])
def test_another_version_of_the_firmware_is_the_same_board(firmware: str) -> None:
    observed = ObservedKeeper(OF_FILE)

    assert observed.after(REAL, (7, firmware)).plant == HEAVY
    assert observed.events == []


@pytest.mark.parametrize("other", [(8, "1.0 at89c51"), CUSTOM_RIG])
def test_with_another_board_a_card_is_doubted_once(other: tuple[int, str]) -> None:
    observed = ObservedKeeper(OF_FILE)

    card = observed.after(REAL, other, other)

    assert card.plant == HEAVY
    assert observed.events == ["plant-of-another-board"]


def test_an_emulated_ce_152_has_its_own_plant_after_another_rig_and_none_is_left_for_a_real_one() -> None:
    observed = ObservedKeeper(OF_FILE)

    emulated = observed.after(CUSTOM_RIG, CE152)
    left = observed.after(REAL)

    assert (emulated.who, emulated.plant.mass_kg) == (EMULATED, 8.28e-3)
    assert observed.events == ["plant-stated"]
    assert not left.HasField("plant")


def test_what_was_stated_for_an_emulated_ce_152_stays() -> None:
    observed = ObservedKeeper(pb.PlantCard())
    observed.after(CE152)
    observed.keeper.take(
        pb.Command(who="ana", set_plant=pb.SetPlant(plant=HEAVY)), 200, tick=0, session=0, highest_reference_m=None
    )

    card = observed.after(CE152)

    assert (card.plant, card.who, card.board) == (HEAVY, "ana", "1 emulated")
