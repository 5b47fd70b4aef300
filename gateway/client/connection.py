"""The bus as its clients see it: open a session, send a command.  `rig.py` is what programs use.

An empty list of replies means any of: no gateway, no rights, crashed, not answered.  The gateway always answers, so
empty is "not delivered" and is said as such.
"""

from __future__ import annotations

import argparse
import getpass
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

JUST_STARTED_S = 2.0  # longer than a gateway refuses what may be older than itself (access/authorize.py)


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
    typed: bool = True,
) -> pb.CommandReply:
    """Send one command and return the gateway's answer; `refused_by` "link" where none came.

    An empty `command.id` and a missing `issued_ns` are filled in.  Keep both to repeat a command, at this gateway or
    the next one: it is not executed twice.  What is filled in here is new, so a gateway that has just started and
    cannot know that (`not-fresh`) is asked again for a moment.

    Args:
        session: of the bus.
        site: first chunk of the key.
        board: second.
        command: what.
        timeout_s: for the answer; the command does not begin to act later.
        identity: whose command it is, on a guarded bus.
        role: instead of an identity: of `command.who`, whom the caller has checked; only the views' account may do so.
        typed: whether the sender gave endpoint and identity, which may be wrong.
    """
    if not command.id:
        command.id = uuid.uuid4().hex
    is_new = not command.issued_ns
    command.valid_s = command.valid_s or timeout_s
    if identity is not None:
        role, command.who = identity.role, identity.name
    key = topics.command_key(site, board, role=role, who=command.who)
    end_s = time.monotonic() + min(timeout_s, JUST_STARTED_S)
    while True:
        if is_new:
            command.issued_ns = time.time_ns()
        answer = ask(session, key, command, timeout_s)
        if answer is None:
            return _unanswered(command, f"{site}/{board}", guarded=identity is not None, typed=typed)
        if not is_new or answer.reason != "not-fresh" or time.monotonic() >= end_s:
            return answer
        time.sleep(0.1)


def ask(
    session: zenoh.Session, key: str, command: pb.Command | pb.TwinCommand, timeout_s: float
) -> pb.CommandReply | None:
    """Put one query as it is; the first answer, or None."""
    replies = session.get(
        key, payload=command.SerializeToString(), encoding=zenoh_encoding(type(command)), timeout=timeout_s
    )
    answers = (parse(pb.CommandReply, reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None)
    return next((answer for answer in answers if answer is not None), None)


def _unanswered(command: pb.Command, board: str, *, guarded: bool, typed: bool) -> pb.CommandReply:
    text = f"No gateway answered for {board}: is it running, and is that the board's name?"
    if typed:
        options = " If its bus is not guarded, give no identity.", " A guarded bus needs an identity (--identity)."
        text += options[0] if guarded else options[1]
    text += " Had one received the command before it ended, it may have acted."
    return pb.CommandReply(id=command.id, refused_by="link", reason="not-delivered", text=text)


def login_name() -> str:
    """Of who runs this process."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user need not have a name
        return "unknown"
