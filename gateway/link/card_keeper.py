"""The plant card of one board: stated by a command, by the configuration, or by an emulated board.  No I/O.

Rule 1: impossible values are refused; unusual ones are refused until the sender confirms them (protocol/plant.py).
Rule 2: a change is an event with sender, new and old values, and a message of `plant`; both are in the log.
Rule 3: an emulated CE 152 has the published plant until somebody states another one.
"""

from __future__ import annotations

from dataclasses import asdict

from gateway.board.emulated import emulated_plant
from gateway.board.scaling import Refusal
from gateway.link.sink import Sink
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED, card_plant, plant_message, plant_of
from protocol.plant import in_words, objections

MAX_NAME = 64
STATED = "plant-stated"  # the event


class CardKeeper:
    """The card of one board.  Written by the serial thread, read by any thread."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.card = pb.PlantCard()  # replaced, never changed

    def take(
        self, command: pb.Command, host_ns: int, *, tick: int, session: int, highest_reference_m: float | None
    ) -> pb.CommandReply | Refusal:
        """Execute a `set_plant` at the given tick of the board, whose highest reference may be known."""
        stated, who = command.set_plant, command.who or "unknown"
        refusal = _refused(stated, highest_reference_m)
        if refusal is not None:
            return refusal
        before = card_plant(self.card)
        self._replace(pb.PlantCard(plant=stated.plant, who=who, stated_ns=host_ns), host_ns)
        said = (
            f"{who}: {in_words(plant_of(stated.plant))}; before: {'not stated' if before is None else in_words(before)}"
        )
        text = "".join(c if c.isprintable() else " " for c in said)
        event = pb.Event(host_time_ns=host_ns, tick=tick, session=session, source="gateway", severity="info")
        event.name, event.text = STATED, text
        self._sink.send("event", event, host_ns)
        return pb.CommandReply(id=command.id, accepted=True, tick=tick)

    def recognise(self, firmware: str, host_ns: int) -> None:
        """Let the build of the board state its plant, unless somebody has stated one."""
        if self.card.HasField("plant") and self.card.who != EMULATED:
            return
        plant = emulated_plant(firmware)
        if plant is None and self.card.HasField("plant"):  # another board has come to the port
            self._replace(pb.PlantCard(), host_ns)
        elif plant is not None and not self.card.HasField("plant"):
            self._replace(pb.PlantCard(plant=plant_message(plant), who=EMULATED, stated_ns=host_ns), host_ns)

    def send(self, host_ns: int) -> None:
        """Publish the card."""
        message = pb.PlantCard(host_time_ns=host_ns)
        message.MergeFrom(self.card)
        self._sink.send("plant", message, host_ns)

    def _replace(self, card: pb.PlantCard, host_ns: int) -> None:
        self.card = card
        self.send(host_ns)


def _refused(stated: pb.SetPlant, highest_reference_m: float | None) -> Refusal | None:
    plant = plant_of(stated.plant)
    if not 0 < len(plant.name) <= MAX_NAME:
        return Refusal("malformed", f"The name of a rig has 1 to {MAX_NAME} characters, not {len(plant.name)}.")
    answers = objections(asdict(plant), highest_reference_m=highest_reference_m)
    errors = [objection.text for objection in answers if objection.is_error]
    if errors:
        return Refusal("implausible", " ".join(errors))
    if answers and not stated.confirmed:
        return Refusal("not-confirmed", " ".join(objection.text for objection in answers))
    return None
