"""Errors of a rig.

ServiceError
├── CommandRefusedError         gateway, board or twin refused the command: nothing has changed
├── CommandNotDeliveredError    no answer: it is unknown whether the board has acted, unless the text says so
└── NoSamplesError              no more samples arrive
"""

from __future__ import annotations

from gateway.client.values import Reply
from protocol.bus import board51_pb2 as pb
from protocol.errors import ServiceError

_REMEDIES = {
    "not-allowed": "Use the identity of a user whose role may do this",
    "not-fresh": "Set the clock of this computer, or of the gateway's, right",
    "flood": "Send fewer commands per second",
    "slew": "Move in smaller steps, or wait in between",
    "wrong-mode": "Change the mode first",
    "fault-active": "Look at the event that the fault has left, then set a mode",
    "no-session": "Wait until the gateway says that the board streams",
}


class CommandRefusedError(ServiceError):
    """Gateway, board or twin refused a command; nothing has changed.

    `reason` is a stable name in kebab-case; `refused_by` is the component that refused.
    """

    def __init__(self, command: pb.Command | pb.TwinCommand, reply: pb.CommandReply) -> None:
        self.reason, self.refused_by = reply.reason, reply.refused_by
        super().__init__(
            f"{_what(command)} was refused by the {reply.refused_by}: {reply.reason}: {reply.text.rstrip('.')}",
            remedy=_REMEDIES.get(reply.reason, "Correct the command, and send it again"),
        )


class CommandNotDeliveredError(ServiceError):
    """A command was not answered.

    `command` has its id and date, so `rig.send(error.command)` repeats it without executing it twice.  `attempts` is
    the number of frames sent to the board; with 0 it has not acted.
    """

    def __init__(self, command: pb.Command, reply: pb.CommandReply) -> None:
        self.reason, self.attempts = reply.reason, reply.attempts
        self.command = pb.Command()
        self.command.CopyFrom(command)
        remedy = "Look at rig.status(); rig.send(error.command) repeats it; it is executed at most once"
        if command.WhichOneof("what") == "stop":
            remedy = "THE COIL MAY BE ON: switch off its supply; else the board's host-loss policy decides"
        text = f"{_what(command)} was not answered: {reply.reason}: {reply.text.rstrip('.')}"
        super().__init__(text, remedy=remedy)


class NoSamplesError(ServiceError):
    """The stream of a board has ended or has not begun."""


def _what(command: pb.Command | pb.TwinCommand) -> str:
    return str(command.WhichOneof("what")).replace("_", " ")


def accepted(command: pb.Command | pb.TwinCommand, reply: pb.CommandReply) -> Reply:
    """The reply to a command that was accepted.

    Raises:
        CommandNotDeliveredError: it was not answered.
        CommandRefusedError: it was refused.
    """
    if reply.accepted:
        return Reply.of(reply)
    if reply.refused_by == "link" and isinstance(command, pb.Command):
        raise CommandNotDeliveredError(command, reply)
    raise CommandRefusedError(command, reply)
