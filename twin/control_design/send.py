"""Send a designed controller to a board through its gateway: one SetGains on the bus, and its reply.

Rule: the board's parameters are read first.  Gains for another T_s, or for an operating point outside the board's
      reference range, are refused here.  The board would accept them and lose the ball.
"""

from __future__ import annotations

import queue
import time
import uuid

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.bus.endpoint import check_endpoint
from protocol.bus.identity import Identity
from protocol.errors import ServiceError, UsageError
from twin.control_design.design import Design
from twin.mirror.bus.client import open_client

PARAMETERS_WAIT_S = 7.0  # the gateway repeats them every 5 s
REPLY_WAIT_S = 5.0


def send(design: Design, *, site: str, board: str, endpoint: str, identity: Identity | None = None) -> str:
    """Load `design` into `board`; in closed loop the gains are in force within one tick.

    Returns:
        The reply of the gateway, one line.

    Raises:
        UsageError: the loop is unstable on the model, or the design does not fit the board.
        ServiceError: there is no router or no such board, or the command was refused.
    """
    topics.check_name(site, what="site")
    topics.check_name(board, what="board")
    check_endpoint(endpoint, where="--connect")
    if not design.board.stable:
        raise UsageError("the loop is unstable on its own model: nothing was sent", remedy="Choose other weights")
    with open_client((endpoint,), identity) as session:
        check_board(design, _parameters(session, site, board))
        reply = _send(session, site, board, _command(design), identity)
    if not reply.accepted:
        raise ServiceError(
            f"{site}/{board} did not accept the gains: refused by {reply.refused_by}, {reply.reason} ({reply.text})",
            remedy="Its gains are unchanged; `board51 watch` shows its state",
        )
    return f"{site}/{board} accepted the gains, in force from tick {reply.tick}" + (
        f" ({reply.text})" if reply.text else ""
    )


def check_board(design: Design, parameters: pb.Parameters) -> None:
    """Check that `design` fits the board with these parameters.  Raises UsageError if not."""
    if abs(parameters.sample_time_s - design.sample_time_s) > 1e-6 * design.sample_time_s:
        raise UsageError(
            f"designed for T_s = {design.sample_time_s:g} s, the board runs at {parameters.sample_time_s:g} s",
            remedy=f"Design with --sample-time {parameters.sample_time_s:g}",
        )
    x = design.point.x_m
    if not parameters.x_ref_min_m <= x <= parameters.x_ref_max_m:
        raise UsageError(
            f"operating point x = {x:g} m is outside the board's reference range, "
            f"{parameters.x_ref_min_m:g} to {parameters.x_ref_max_m:g} m",
            remedy="Choose --operating-point within it",
        )
    if not parameters.u_min_v <= design.point.u_v <= parameters.u_max_v:
        raise UsageError(
            f"the input at rest is {design.point.u_v:.3g} V, the board gives "
            f"{parameters.u_min_v:g} to {parameters.u_max_v:g} V",
            remedy="Choose another --operating-point",
        )


def _parameters(session: zenoh.Session, site: str, board: str) -> pb.Parameters:
    messages: queue.Queue[pb.Parameters] = queue.Queue()

    def take(sample: zenoh.Sample) -> None:
        message = parse(pb.Parameters, sample.payload.to_bytes())
        if message is not None:
            messages.put(message)

    session.declare_subscriber(topics.key(site, board, "parameters"), take)  # until the session ends
    try:
        return messages.get(timeout=PARAMETERS_WAIT_S)
    except queue.Empty:
        raise ServiceError(
            f"no message from {site}/{board} within {PARAMETERS_WAIT_S:g} s",
            remedy="Check the name of the board and that its gateway runs; `board51 watch` lists the boards",
        ) from None


def _command(design: Design) -> pb.Command:
    point = design.point
    return pb.Command(
        id=uuid.uuid4().hex,
        who="board51 design",
        # Dated and valid for a short time: gains that were held up must not change a later flight.
        issued_ns=time.time_ns(),
        valid_s=REPLY_WAIT_S,
        set_gains=pb.SetGains(
            law=pb.LAW_PID if design.law == "pid" else pb.LAW_LQI,
            gains=design.gains,
            i_0_a=point.i_a,
            x_0_m=point.x_m,
            u_0_v=point.u_v,
        ),
    )


def _send(
    session: zenoh.Session, site: str, board: str, command: pb.Command, identity: Identity | None
) -> pb.CommandReply:
    role, sender = (identity.role, identity.name) if identity is not None else ("", "")
    replies = session.get(
        topics.command_key(site, board, role=role, who=sender),
        payload=command.SerializeToString(),
        encoding=zenoh_encoding(pb.Command),
        timeout=REPLY_WAIT_S,
    )
    for reply in replies:
        answer = parse(pb.CommandReply, reply.ok.payload.to_bytes()) if reply.ok is not None else None
        if answer is not None:
            return answer
    return pb.CommandReply(id=command.id, refused_by="link", reason="not-delivered", text="no gateway answered")
