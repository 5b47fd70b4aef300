"""The plant card of one board: stated by a command, by the configuration, or by an emulated board.  No I/O.

Rule 1: impossible values are refused; unusual ones are refused until the sender confirms them (protocol/plant.py).
Rule 2: a change is an event with sender, new and old values, and a message of `plant`; both are in the log.
Rule 3: an emulated CE 152 has the published plant until somebody states another one for it.
Rule 4: a card belongs to the board (serial number, build) that was there when it was stated, or that came first after.
        With another board it is doubted, and the card of an emulated rig gives way to that of an emulated CE 152.
"""

from __future__ import annotations

from dataclasses import asdict

from gateway.board.emulated import emulated_plant
from gateway.board.scaling import Refusal
from gateway.link.sink import Sink
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import EMULATED, card_plant, plant_message, plant_of
from protocol.plant import MAX_NAME, in_words, objections

STATED = "plant-stated"  # the event


class CardKeeper:
    """The card of one board.  Written by the serial thread, read by any thread."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.card = pb.PlantCard()  # replaced, never changed
        self._board = ""  # at the port, or the last one that was
        self._doubted = ""  # the board for which the card was not stated

    def take(
        self, command: pb.Command, host_ns: int, *, tick: int, session: int, highest_reference_m: float | None
    ) -> pb.CommandReply | Refusal:
        """Execute a `set_plant` at the given tick of the board, whose highest reference may be known."""
        stated, who = command.set_plant, command.who or "unknown"
        refusal = _refused(stated, highest_reference_m)
        if refusal is not None:
            return refusal
        before = card_plant(self.card)
        card = pb.PlantCard(plant=stated.plant, who=who, stated_ns=host_ns, board=self._board)
        self._replace(card, host_ns)
        text = (
            f"{who}: {in_words(plant_of(stated.plant))}; before: {'not stated' if before is None else in_words(before)}"
        )
        self._publish(STATED, "info", text, pb.Event(host_time_ns=host_ns, tick=tick, session=session))
        return pb.CommandReply(id=command.id, accepted=True, tick=tick)

    def board_is(self, board_id: int, firmware: str, host_ns: int) -> None:
        """Compare the card with the board that has come to the port; an emulated CE 152 states its own plant."""
        self._board = f"{board_id} {firmware.partition(' ')[2]}"
        emulated, is_ours = emulated_plant(firmware), self.card.board in ("", self._board)
        is_stated = self.card.HasField("plant") and self.card.who != EMULATED
        if is_stated and is_ours:
            if not self.card.board:  # of a file, which does not know the board
                card = pb.PlantCard(board=self._board)
                card.MergeFrom(self.card)
                self._replace(card, host_ns)
        elif emulated is not None:
            if is_stated or not self.card.HasField("plant"):
                if is_stated:
                    text = f"{EMULATED}: {in_words(emulated)}; before: {in_words(plant_of(self.card.plant))}"
                    self._publish(STATED, "info", text, pb.Event(host_time_ns=host_ns))
                card = pb.PlantCard(plant=plant_message(emulated), who=EMULATED, stated_ns=host_ns, board=self._board)
                self._replace(card, host_ns)
        elif is_stated:
            # Once for each board: this is called with every reading of the parameters.
            if self._doubted != self._board:
                self._doubted = self._board
                text = f"The plant card was stated for board {self.card.board}, this is {self._board}: state its plant."
                self._publish("plant-of-another-board", "warning", text, pb.Event(host_time_ns=host_ns))
        elif self.card.HasField("plant"):  # of an emulated board that was here before
            self._replace(pb.PlantCard(), host_ns)

    def send(self, host_ns: int) -> None:
        """Publish the card."""
        message = pb.PlantCard(host_time_ns=host_ns)
        message.MergeFrom(self.card)
        self._sink.send("plant", message, host_ns)

    def _publish(self, name: str, severity: str, text: str, event: pb.Event) -> None:
        event.source, event.name, event.severity = "gateway", name, severity
        event.text = "".join(c if c.isprintable() else " " for c in text)
        self._sink.send("event", event, event.host_time_ns)

    def _replace(self, card: pb.PlantCard, host_ns: int) -> None:
        self.card = card
        self.send(host_ns)


def _refused(stated: pb.SetPlant, highest_reference_m: float | None) -> Refusal | None:
    plant = plant_of(stated.plant)
    if not 0 < len(plant.name) <= MAX_NAME:
        return Refusal("malformed", f"The name of a rig has 1 to {MAX_NAME} characters, not {len(plant.name)}.")
    answers = objections(asdict(plant), highest_reference_m=highest_reference_m)
    # Errors first: a confirmation makes no impossible plant possible.
    errors = [objection.text for objection in answers if objection.is_error]
    if errors:
        return Refusal("implausible", " ".join(errors))
    if answers and not stated.confirmed:
        return Refusal("not-confirmed", " ".join(objection.text for objection in answers))
    return None
