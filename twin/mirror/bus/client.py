"""The client side of a hand-over: send a model to the running twins and collect their answers."""

from __future__ import annotations

import uuid
from dataclasses import dataclass

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.bus.endpoint import router_refusal, zenoh_config
from protocol.bus.identity import Identity
from protocol.errors import ServiceError
from twin.mirror.bus.handover import Belief

# No twin at all is known at once; one that has just started may be compiling: some 10 s, on a busy machine more.
REPLY_WAIT_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The reply of one board's twin; `board` is "*" if the twin knows no board yet, or refused for all."""

    board: str
    reply: pb.CommandReply

    def __str__(self) -> str:
        refused = "" if self.reply.accepted else f"refused: {self.reply.reason}: "
        return f"{self.board}: {refused}{self.reply.text}"


def open_client(endpoints: tuple[str, ...], identity: Identity | None = None) -> zenoh.Session:
    """Open a session on the bus.  Raises ServiceError where no router answers."""
    try:
        return zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=endpoints, identity=identity)))
    except zenoh.ZError:
        raise router_refusal(endpoints, identity) from None


def hand_over(
    belief: Belief,
    *,
    site: str,
    board: str | None,
    endpoints: tuple[str, ...],
    command_id: str = "",
    identity: Identity | None = None,
) -> list[Answer]:
    """Hand `belief` to the twin of `board`, or to every twin of the site.

    Args:
        belief: model, its text, and who hands it over.
        site: first chunk of the keys.
        board: second; None: all, those to come too.
        endpoints: where the router listens.
        command_id: the same id is executed at most once; empty: a new one.
        identity: whose command it is, on a guarded bus.

    Raises:
        ServiceError: no router, or no twin that follows this board.
    """
    session = open_client(endpoints, identity)
    command = pb.TwinCommand(id=command_id or uuid.uuid4().hex, who=belief.who)
    command.use_model.model_json = belief.text
    role, who = (identity.role, identity.name) if identity is not None else ("", "")
    answers = []
    with session:
        # Every twin that follows the board, not the nearest; and no reply of one stands for that of another.
        for reply in session.get(
            topics.command_key(site, board or "*", role=role, who=who, topic="twin/command"),
            payload=command.SerializeToString(),
            encoding=zenoh_encoding(pb.TwinCommand),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=REPLY_WAIT_S,
        ):
            message = parse(pb.CommandReply, reply.ok.payload.to_bytes()) if reply.ok is not None else None
            parts = topics.split(str(reply.ok.key_expr)) if reply.ok is not None else None
            if message is not None and parts is not None:
                answers.append(Answer(board=parts[1], reply=message))
    if not answers:
        raise ServiceError(
            f"No twin answers for {site}/{board or '*'} at {', '.join(endpoints)}",
            remedy="Start `board51 twin`, or check --site and --board"
            + (f"; {who} is {role}, and only an engineer hands models over" if role not in ("", "engineer") else ""),
        )
    return sorted(answers, key=lambda answer: answer.board)
