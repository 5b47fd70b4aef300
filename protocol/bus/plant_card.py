"""A plant as a message of the bus, and back.  Pure."""

from __future__ import annotations

from protocol.bus import board51_pb2 as pb
from protocol.plant import Plant, is_possible

EMULATED = "emulated board"  # who stated the card of an emulated CE 152: its build


def plant_message(plant: Plant) -> pb.Plant:
    """Return the message of a plant; it does not say whether the plant is assumed."""
    return pb.Plant(
        name=plant.name,
        mass_kg=plant.mass_kg,
        travel_m=plant.travel_m,
        x_max_m=plant.x_max_m,
        gravity_m_s2=plant.gravity_m_s2,
        ball_diameter_m=plant.ball_diameter_m,
    )


def plant_of(message: pb.Plant) -> Plant:
    """Return the plant of a message, not judged."""
    return Plant(
        name=message.name,
        mass_kg=message.mass_kg,
        travel_m=message.travel_m,
        x_max_m=message.x_max_m,
        gravity_m_s2=message.gravity_m_s2,
        ball_diameter_m=message.ball_diameter_m if message.HasField("ball_diameter_m") else None,
    )


def card_plant(card: pb.PlantCard | None) -> Plant | None:
    """Return the plant of a card; None without one, where nobody stated it, or where no gateway lets it through."""
    plant = plant_of(card.plant) if card is not None and card.HasField("plant") else None
    return plant if plant is not None and is_possible(plant) else None
