"""A client of the bus: open a session, send a command, subscribe.  For the commands; other programs need only zenoh.

An empty list of replies means any of: no gateway, no rights, crashed, not answered.  The gateway always answers, so
empty is "not delivered" and is said as such.
"""

from __future__ import annotations

import argparse
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint, refused_by_router, zenoh_config
from protocol.bus.identity import HELP, Identity


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """`--connect`, `--site` and `--identity`, the same everywhere."""
    parser.add_argument(
        "--connect",
        default=DEFAULT_ENDPOINT,
        metavar="ENDPOINT",
        help=f"the router's endpoint (default {DEFAULT_ENDPOINT})",
    )
    parser.add_argument(
        "--site", default=topics.DEFAULT_SITE, help=f"first chunk of the keys (default {topics.DEFAULT_SITE})"
    )
    parser.add_argument("--identity", metavar="FOLDER", help=HELP)


@contextmanager
def open_bus(connect: str, identity: Identity | None = None) -> Iterator[zenoh.Session]:
    """A client session at `connect`.

    Args:
        connect: the router's endpoint.
        identity: who this is on a guarded bus.

    Raises:
        ConfigError: not an endpoint, or an identity that has expired.
        ServiceError: nobody listens there, or not to this identity.
    """
    check_endpoint(connect, where="--connect")
    if identity is not None:
        identity.check_valid(datetime.now(UTC))
    try:
        session = zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=[connect], identity=identity)))
    except zenoh.ZError:
        raise refused_by_router([connect], identity) from None
    with session:
        yield session


def send(
    session: zenoh.Session,
    site: str,
    board: str,
    command: pb.Command,
    *,
    timeout_s: float = 5.0,
    identity: Identity | None = None,
    role: str = "",
) -> pb.CommandReply:
    """Send one command and return the gateway's answer; `refused_by` "link" where none came.

    An empty `command.id` is filled in; keep it to repeat a command without its being executed twice.

    Args:
        session: of the bus.
        site: first chunk of the key.
        board: second.
        command: what; `issued_ns` is filled in.
        timeout_s: for the answer.
        identity: whose command it is, on a guarded bus.
        role: instead of an identity: of `command.who`, whom the caller has checked; only the views' account may do so.
    """
    if not command.id:
        command.id = uuid.uuid4().hex
    command.issued_ns = time.time_ns()
    if identity is not None:
        role, command.who = identity.role, identity.name
    replies = session.get(
        topics.command_key(site, board, role=role, who=command.who),
        payload=command.SerializeToString(),
        encoding=zenoh_encoding(pb.Command),
        timeout=timeout_s,
    )
    for reply in replies:
        answer = parse(pb.CommandReply, reply.ok.payload.to_bytes()) if reply.ok is not None else None
        if answer is not None:
            return answer
    return pb.CommandReply(
        id=command.id,
        refused_by="link",
        reason="not-delivered",
        text=f"No gateway answered for {site}/{board}: is it running, and is that the board's name?"
        + (" If it does not guard its bus, leave --identity out." if identity else " A guarded one wants --identity."),
    )
