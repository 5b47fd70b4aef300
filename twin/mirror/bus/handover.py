"""Handing a model over to a running twin: the command and its reply.  Pure.

Rule 1: nothing that comes over the bus raises.  A bad command, text that is not a model, and a model that is not
        physical are refused with a stable reason and a sentence.  Reasons: malformed, oversize, bad-id, bad-who,
        empty-command, bad-model, not-runnable, unknown-board, id-reused, queue-full.
Rule 2: an id is executed at most once on a key; the same command again gets the replies it got.  The same id with
        another model is refused: "accepted" would be a lie.
Rule 3: equal models have equal text and an equal hash, however their files were laid out.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass

from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import parse
from protocol.errors import DataError
from twin.model.parameters import MAX_NAME, NAME_REMEDY, Model, model_text, name_problem, parse_model

MAX_PAYLOAD = 400_000  # bytes; an identified model has some 10 000, and the queue of a router holds 1 MiB
MAX_WORD = 128  # characters of id and who, as for the gateway's commands
RETAINED_IDS = 256
SHORT = 12  # digits of a hash for people


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """A model that a twin uses, and its origin."""

    model: Model
    text: str  # JSON
    sha256: str  # of the text
    who: str = ""  # empty: the twin was started with it
    command_id: str = ""

    @property
    def title(self) -> str:
        """Return a title for a person: name and first digits of the hash."""
        return f"{self.model.name} ({self.sha256[:SHORT]})"

    def message(self, *, session: int, since_tick: int, host_time_ns: int) -> pb.TwinModel:
        """Return the message that publishes this model at this time of the gateway's clock."""
        return pb.TwinModel(
            session=session,
            since_tick=since_tick,
            name=self.model.name,
            model_json=self.text,
            sha256=self.sha256,
            who=self.who,
            command_id=self.command_id,
            host_time_ns=host_time_ns,
        )


def believe(model: Model, *, who: str = "", command_id: str = "") -> Belief:
    """Write `model` down.  Raises DataError where it cannot be written as JSON that everybody reads."""
    try:
        # Written anew, not taken from its file: so equal models have equal text.
        text = model_text(model)
        digest = hashlib.sha256(text.encode()).hexdigest()
    except (ValueError, RecursionError) as error:
        raise DataError(
            f"the model {model.plant.name[:MAX_NAME]!r} is not plain JSON ({error})",
            remedy="Remove NaN, Infinity and broken characters from its provenance",
        ) from None
    for key, name in (("plant.name", model.plant.name), ("provenance.name", str(model.provenance.get("name", "")))):
        if problem := name_problem(name):
            raise DataError(f"{key} {problem}", remedy=NAME_REMEDY)
    return Belief(model=model, text=text, sha256=digest, who=who, command_id=command_id)


def refusal(reason: str, text: str, *, command_id: str = "") -> pb.CommandReply:
    """A reply that refuses a command."""
    return pb.CommandReply(id=command_id, refused_by="twin", reason=reason, text=text)


def read_command(payload: bytes) -> pb.TwinCommand | pb.CommandReply:
    """The command in a query, or the refusal; its form, not yet its model."""
    # Before it is parsed: the work must not grow with what a stranger sends.
    if len(payload) > MAX_PAYLOAD:
        return refusal("oversize", f"The payload has {len(payload)} bytes; at most {MAX_PAYLOAD}.")
    command = parse(pb.TwinCommand, payload)
    if command is None:
        return refusal("malformed", "The payload is not a board51.v1.TwinCommand in protobuf.")
    if not 0 < len(command.id) <= MAX_WORD:
        return refusal(
            "bad-id", f"The id has {len(command.id)} characters; choose 1 to {MAX_WORD}, new for each command."
        )
    if not (len(command.who) <= MAX_WORD and command.who.isprintable()):
        return refusal(
            "bad-who",
            f"The sender's name is not printable, or longer than {MAX_WORD} characters.",
            command_id=command.id,
        )
    if command.WhichOneof("what") is None:
        return refusal(
            "empty-command",
            "The command has no action that this twin can perform; give it use_model.",
            command_id=command.id,
        )
    return command


def read_model(command: pb.TwinCommand) -> Belief | pb.CommandReply:
    """The model of a `use_model`, checked as a model file is, or the refusal that names what is wrong with it."""
    try:
        model = parse_model(command.use_model.model_json, where="the model handed over")
        return believe(model, who=command.who, command_id=command.id)
    except DataError as error:
        return refusal("bad-model", str(error), command_id=command.id)


@dataclass(frozen=True, slots=True)
class _Retained:
    content: bytes
    replies: list[tuple[str, pb.CommandReply]]


class Answered:
    """The replies of the last commands, by key and id."""

    def __init__(self) -> None:
        self._retained: OrderedDict[tuple[str, str], _Retained] = OrderedDict()

    def again(self, key: str, command: pb.TwinCommand) -> list[tuple[str, pb.CommandReply]] | None:
        """Return (key, reply) of a command that was answered before; None for a new one."""
        retained = self._retained.get((key, command.id))
        if retained is None:
            return None
        if retained.content != _content(command):
            text = "This id was used for another command; choose a new one."
            return [(key, refusal("id-reused", text, command_id=command.id))]
        return retained.replies

    def keep(self, key: str, command: pb.TwinCommand, replies: list[tuple[str, pb.CommandReply]]) -> None:
        """Remember what was answered."""
        self._retained[key, command.id] = _Retained(_content(command), replies)
        if len(self._retained) > RETAINED_IDS:
            # The oldest: a sender repeats within its time-out.
            self._retained.popitem(last=False)


def _content(command: pb.TwinCommand) -> bytes:
    """Hash what the command does without who asks for it; a hash, because the text may be long."""
    bare = pb.TwinCommand()
    bare.CopyFrom(command)
    bare.who = ""
    return hashlib.sha256(bare.SerializeToString(deterministic=True)).digest()
