"""A client of the bus: open a session, send a command, subscribe.  For the commands; other programs need only zenoh.

An empty list of replies means any of: no gateway, no rights, crashed, not answered.  The gateway always answers, so
empty is "not delivered" and is said as such.
"""

from __future__ import annotations

import argparse
import uuid
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint, zenoh_config
from protocol.errors import ServiceError


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """`--connect` and `--site`, the same everywhere."""
    parser.add_argument(
        "--connect",
        default=DEFAULT_ENDPOINT,
        metavar="ENDPOINT",
        help=f"the router's endpoint (default {DEFAULT_ENDPOINT})",
    )
    parser.add_argument(
        "--site", default=topics.DEFAULT_SITE, help=f"first chunk of the keys (default {topics.DEFAULT_SITE})"
    )


@contextmanager
def open_bus(connect: str) -> Iterator[zenoh.Session]:
    """A client session at `connect`.

    Raises:
        ConfigError: not an endpoint.
        ServiceError: nobody listens there.
    """
    check_endpoint(connect, where="--connect")
    try:
        session = zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=[connect])))
    except zenoh.ZError:
        raise ServiceError(
            f"No router answers at {connect}", remedy="Start `board51 gateway`, or give its endpoint with --connect"
        ) from None
    with session:
        yield session


def send(
    session: zenoh.Session, site: str, board: str, command: pb.Command, *, timeout_s: float = 5.0
) -> pb.CommandReply:
    """Send one command and return the gateway's answer; `refused_by` "link" where none came.

    An empty `command.id` is filled in; keep it to repeat a command without its being executed twice.
    """
    if not command.id:
        command.id = uuid.uuid4().hex
    replies = session.get(
        topics.key(site, board, "command"),
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
        text=f"No gateway answered for {site}/{board}: is it running, and is that the board's name?",
    )
