"""A plant as a message of the bus, and back.  Pure."""

from __future__ import annotations

from protocol.bus import board51_pb2 as pb
from protocol.plant import Plant, is_possible

EMULATED = "emulated board"  # who stated the card of an emulated CE 152: its build
_NAMES = tuple(pb.Plant.DESCRIPTOR.fields_by_name)  # those of a Plant


def plant_message(plant: Plant) -> pb.Plant:
    """Return the message of a plant; it does not say whether the plant is assumed."""
    return pb.Plant(**{name: getattr(plant, name) for name in _NAMES})


def plant_of(message: pb.Plant) -> Plant:
    """Return the plant of a message, not judged."""
    values = {name: getattr(message, name) for name in _NAMES}
    return Plant(**values | ({} if message.HasField("ball_diameter_m") else {"ball_diameter_m": None}))


def card_plant(card: pb.PlantCard | None) -> Plant | None:
    """Return the plant of a card; None without one, where nobody stated it, or where no gateway lets it through."""
    plant = plant_of(card.plant) if card is not None and card.HasField("plant") else None
    return plant if plant is not None and is_possible(plant) else None
