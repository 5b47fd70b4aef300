"""The client side of the bus: open a session, send a command.  Programs use `rig.py`.

The gateway always answers a command.  So an empty list of replies means that there is no gateway, that it crashed, or
that the client has no rights; it is reported as "not delivered".
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import zenoh
from zenoh.handlers import Callback

from gateway.client.errors import accepted
from gateway.client.values import Reply
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint, router_refusal, zenoh_config
from protocol.bus.identity import HELP, Identity, find_identity, login_name
from protocol.errors import ServiceError, UsageError

JUST_STARTED_S = 2.0  # longer than a new gateway refuses commands that may be older than itself (access/authorize.py)
STOP_PATIENCE_S = 10.0  # time for which STOP is repeated
STOP_WAIT_S = 2.0  # for each answer
_LAST_CALL_S = 2.0  # a subscription that ends waits so long for the callback under way
# Commands that move nothing.
_AT_REST = frozenset({"stop", "ping", "mark", "acknowledge", "set_plant", "set_stream", "set_host_loss"})


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--connect`, `--site` and `--identity`."""
    parser.add_argument(
        "--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT", help="the router's endpoint (default %(default)s)"
    )
    parser.add_argument("--site", default=topics.DEFAULT_SITE, help="first chunk of the keys (default %(default)s)")
    parser.add_argument("--identity", metavar="FOLDER", help=HELP)


@contextlib.contextmanager
def open_bus(connect: str, identity: Identity | None = None) -> Iterator[zenoh.Session]:
    """Open a client session; a context manager.

    Raises:
        ConfigError: `connect` is not an endpoint, or the identity has expired.
        ServiceError: there is no router, or it refuses this identity.
    """
    check_endpoint(connect, where="--connect")
    if identity is not None:
        identity.check_valid(datetime.now(UTC))
    try:
        session = zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=[connect], identity=identity)))
    except zenoh.ZError:
        raise router_refusal([connect], identity) from None
    with session:
        yield session


class BusBoard(NamedTuple):
    """A board on an open bus."""

    session: zenoh.Session
    site: str  # first chunk of its keys
    board: str  # second chunk of its keys; "*": every board

    def __str__(self) -> str:
        return f"{self.site}/{self.board}"


class Subscription:
    """A subscription that lets the interpreter end while it is open.

    zenoh calls back in a Python thread, and the interpreter waits for each thread that is not a daemon.  zenoh has no
    option for that, but a thread inherits it from the one that starts it.  Callbacks without a thread of their own
    (`indirect=False`) would hold up zenoh's receiver, and with it lose samples while another thread computes.

    Each key expression has a thread of its own: only messages of the same one keep their order.
    """

    def __init__(self, session: zenoh.Session, keys: Iterable[str], receive: Callable[[zenoh.Sample], None]) -> None:
        declared: Future[list[zenoh.Subscriber[None]]] = Future()
        self._ended = threading.Semaphore(0)  # counts the threads that have called back for the last time
        callback = Callback(receive, self._ended.release)

        def declare() -> None:
            try:
                declared.set_result([session.declare_subscriber(key, callback) for key in keys])
            except BaseException as error:
                declared.set_exception(error)

        threading.Thread(target=declare, name="subscribe", daemon=True).start()
        self._subscribers = declared.result()

    def close(self) -> None:
        """End the subscription and wait for its threads.  May be called again.

        If the interpreter ended while zenoh still wakes such a thread, the process would abort: Python ends the thread
        by an exception that zenoh's Rust code does not pass on.
        """
        subscribers, self._subscribers = self._subscribers, []
        for subscriber in subscribers:
            with contextlib.suppress(zenoh.ZError):  # the session is closed
                subscriber.undeclare()
        for _ in subscribers:
            self._ended.acquire(timeout=_LAST_CALL_S)


def send(
    board: BusBoard,
    command: pb.Command,
    *,
    timeout_s: float = 5.0,
    identity: Identity | None = None,
    role: str = "",
    typed: bool = True,
    since_ns: int = 0,
) -> pb.CommandReply:
    """Send one command and return the gateway's answer; without an answer `refused_by` is "link".

    The head of the command is completed in place: an empty `id`, a missing `issued_ns` (`since_ns`; 0: now).  A command
    that is sent again with the same id and date, at this or another gateway, is not executed twice.  It does not begin
    to act after `timeout_s`.  A gateway that has just started refuses commands that may be older than itself
    (`not-fresh`); a command that was dated here is then sent again for JUST_STARTED_S.  A STOP in between gives it up:
    the gateway remembers its first arrival.

    On a guarded bus the sender has an identity, or the views' account gives the `role` of a `command.who` whom it has
    authenticated.  `typed`: the user gave endpoint and identity; the message for a missing answer then mentions them.
    """
    if not command.id:
        command.id = new_id()
    is_new = not command.issued_ns
    command.valid_s = command.valid_s or timeout_s
    if identity is not None:
        role, command.who = identity.role, identity.name
    key = topics.command_key(board.site, board.board, role=role, who=command.who)
    end_s = time.monotonic() + min(timeout_s, JUST_STARTED_S)
    while True:
        if is_new:
            command.issued_ns, since_ns = since_ns or time.time_ns(), 0
        answer = ask(board.session, key, command, timeout_s)
        if answer is None:
            return _unanswered(command, str(board), guarded=identity is not None, typed=typed)
        if not is_new or answer.reason != "not-fresh" or time.monotonic() >= end_s:
            return answer
        time.sleep(0.1)


def new_id() -> str:
    """Return a new command id: 128 random bits."""
    return os.urandom(16).hex()  # as uuid4, whose module takes a tenth of the start of `board51 send`


def send_stop(board: BusBoard, who: str, *, identity: Identity | None = None) -> tuple[pb.Command, pb.CommandReply]:
    """Send new STOPs until one is accepted, for STOP_PATIENCE_S; returns the last with its reply."""
    end_s = time.monotonic() + STOP_PATIENCE_S
    while True:
        command = pb.Command(who=who, stop=pb.Stop())
        reply = send(board, command, timeout_s=STOP_WAIT_S, identity=identity)
        if reply.accepted or time.monotonic() > end_s:
            return command, reply
        time.sleep(0.1)


def ask(
    session: zenoh.Session, key: str, command: pb.Command | pb.TwinCommand, timeout_s: float
) -> pb.CommandReply | None:
    """Send one query unchanged; returns the first answer, or None."""
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
    text += " If a gateway received the command before it ended, the board may have acted."
    return pb.CommandReply(id=command.id, refused_by="link", reason="not-delivered", text=text)


class BoardConnection:
    """The base of `Rig`, which has its arguments: opening, closing, any command, STOP and all messages of a board.

    Rules 2 and 3 of `rig.py` hold here.
    """

    def __init__(
        self,
        board: str,
        *,
        connect: str = DEFAULT_ENDPOINT,
        site: str = topics.DEFAULT_SITE,
        identity: Identity | Path | str | None = None,
        who: str = "",
        timeout_s: float = 5.0,
        stop_on_error: bool = True,
    ) -> None:
        self.board, self.site = topics.check_name(board, what="board"), topics.check_name(site, what="site")
        self.connect = check_endpoint(connect, where="connect")
        self.identity = identity if isinstance(identity, Identity) else find_identity(identity)
        if self.identity is not None:
            self.identity.check_valid(datetime.now(UTC))
        if not 0 < timeout_s < math.inf:
            raise UsageError(f"timeout_s is {timeout_s}", remedy="Give a positive time in seconds")
        self.who = who or login_name()
        self._timeout_s, self._stop_on_error = timeout_s, stop_on_error
        self._has_moved = False
        self._open: zenoh.Session | None = None
        self._closing = contextlib.ExitStack()
        weakref.finalize(self, self._closing.close)  # of a rig that nobody closed; also when the interpreter ends

    # --- opening and closing

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is not None and self._has_moved and self._stop_on_error:
                self._stop_after(error)
        finally:
            self.close()

    def open(self) -> Self:
        """Join the bus without `with`, as in a notebook.

        The end of the program, whatever its cause, closes the rig; as `close` does, it sends the board no command.

        Raises:
            ServiceError: there is no router, or it refuses this identity.
        """
        if self._open is None:
            self._open = self._closing.enter_context(open_bus(self.connect, self.identity))
        return self

    def close(self) -> None:
        """End recordings and leave the bus without a command to the board.  May be called again."""
        try:
            self._closing.close()
        finally:
            self._open = None

    def _stop_after(self, error: BaseException) -> None:
        try:
            self.stop()
            error.add_note(f"{self.site}/{self.board} was stopped because of this.")
        except ServiceError as second:
            error.add_note(str(second))

    @property
    def _bus_board(self) -> BusBoard:
        if self._open is None:
            problem = f"The rig {self.site}/{self.board} is not open"
            raise UsageError(problem, remedy="Use it in `with Rig(...) as rig:`, or open() it")
        return BusBoard(self._open, self.site, self.board)

    # --- commands

    def stop(self) -> Reply:
        """Switch the coil off at once; mode idle.  It is repeated until it is answered, and works on a closed rig.

        Raises:
            CommandNotDeliveredError: no answer for 10 s: THE COIL MAY BE ON.
        """
        opened = open_bus(self.connect, self.identity) if self._open is None else contextlib.nullcontext(self._open)
        with opened as session:
            board = BusBoard(session, self.site, self.board)
            return accepted(*send_stop(board, self.who, identity=self.identity))

    def send(self, command: pb.Command, *, timeout_s: float | None = None) -> pb.CommandReply:
        """Send any command and return its reply; a refusal is not an exception here.

        An existing `id` and `issued_ns` are kept, so that a command can be repeated without being executed twice.
        Missing fields of its head are filled in.  `timeout_s` is for the answer; None: that of the rig.
        """
        if command.WhichOneof("what") not in _AT_REST:
            self._has_moved = True  # before it is sent, as an interrupted command may act
        command.who = command.who or self.who
        return send(self._bus_board, command, timeout_s=timeout_s or self._timeout_s, identity=self.identity)

    def _execute(self, command: pb.Command) -> Reply:
        return accepted(command, self.send(command))

    def subscribe(self, receive: Callable[[zenoh.Sample], None]) -> Subscription:
        """Call `receive` with all messages of the board, in their order, until the rig is closed; it must be fast."""
        subscription = Subscription(self._bus_board.session, [f"{self.site}/{self.board}/**"], receive)
        return self._closing.enter_context(contextlib.closing(subscription))
