"""Executes writes and method calls as commands of the bus, and returns their results as status codes.

Rule 1: commands use feed.command like all other views, so that the gateway's limits, log and records apply.
Rule 2: rights are those of the table in gateway/access/roles.py.
Rule 3: commands have threads of their own, STOP has others, and a STOP gives up what waits (views/dispatch.py).
Rule 4: every refusal has a status code and, as output of the method and under last_command, its reason in words.
"""

from __future__ import annotations

import math
from typing import Any

from asyncua import ua

from gateway.access.roles import Role, may, refusal_text
from gateway.access.users import User
from gateway.views.dispatch import Dispatch, Wish
from gateway.views.feed import Feed
from gateway.views.opcua.address_space.model import Method
from protocol.bus import board51_pb2 as pb

S = ua.StatusCodes
TIMEOUT_S = 5.0
_NULLABLE = (ua.VariantType.String, ua.VariantType.LocalizedText)
SETPOINTS = {"x_ref_m": ua.VariantType.Double, "mode": ua.VariantType.UInt32}  # what may be written, and its type
OUTPUTS = {  # of each method: fields of the reply
    "accepted": ua.VariantType.Boolean,
    "reason": ua.VariantType.String,
    "text": ua.VariantType.String,
    "tick": ua.VariantType.UInt64,
}
_CODES: dict[str, int] = {
    "not-allowed": S.BadUserAccessDenied,
    "out-of-range": S.BadOutOfRange,
    "not-finite": S.BadOutOfRange,
    "slew": S.BadOutOfRange,
    "wrong-mode": S.BadInvalidState,
    "fault-active": S.BadInvalidState,
    "busy": S.BadInvalidState,
    "no-session": S.BadInvalidState,
    "not-available": S.BadInvalidState,
    "not-fresh": S.BadInvalidTimestamp,
    "internal-error": S.BadInternalError,
    "flood": S.BadTooManyOperations,
    "queue-full": S.BadTooManyOperations,
    "not-delivered": S.BadNoCommunication,
    "link-down": S.BadNoCommunication,
    "disconnected": S.BadNoCommunication,
    "timed-out": S.BadTimeout,
    "superseded-by-stop": S.BadOperationAbandoned,
    "board-reset": S.BadOperationAbandoned,
    "malformed": S.BadInvalidArgument,
    "oversize": S.BadInvalidArgument,
    "no-alarm": S.BadConditionBranchAlreadyAcked,
}


NOBODY = User(name="anonymous", role=Role.VIEWER)


def code_of(reply: pb.CommandReply) -> int:
    """The status code of a reply; a reason that is not in the table is still a refusal."""
    if reply.accepted:
        return int(S.Good)
    return int(_CODES.get(reply.reason, S.BadRequestNotAllowed))


class Operations:
    """Sends the commands of all sessions."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._dispatch = Dispatch("opcua", feed.stopped_s)

    async def command(self, visitor: User, board: str, act: str, command: pb.Command) -> pb.CommandReply:
        """Carry out a command and return its reply.

        A visitor without the right is refused here; on a guarded bus by the gateway, whose log then has the attempt.
        STOP needs a login: a visitor without a name is always refused here.
        """
        text = ""
        if visitor == NOBODY:
            text = "Without a login values can only be read: log in, or give clients a role with --anonymous."
        elif not self._feed.guarded and not may(visitor.role, act):
            text = refusal_text(visitor.name, visitor.role, act)
        if text:
            return pb.CommandReply(id=command.id, refused_by="gateway", reason="not-allowed", text=text)
        wish = Wish(board=board)

        def send() -> pb.CommandReply:
            return self._feed.command(
                board, command, who=visitor.name, role=visitor.role.word, timeout_s=TIMEOUT_S, issued_ns=wish.issued_ns
            )

        if act == "stop":
            return await self._dispatch.stop([board], send)
        return await self._dispatch.act(wish, send)


def written(field: str, value: ua.DataValue) -> tuple[str, pb.Command] | int:
    """Return (action, command) for a value written to a setpoint, or the status code of its refusal."""
    if value.StatusCode is not None and not value.StatusCode.is_good():
        return int(S.BadWriteNotSupported)
    if value.Value is None or not is_of(value.Value, SETPOINTS[field], is_array=False):
        return int(S.BadTypeMismatch)
    number = value.Value.Value
    if field == "x_ref_m":
        if not math.isfinite(number):
            return int(S.BadOutOfRange)
        return "set_reference", pb.Command(set_reference=pb.SetReference(x_ref_m=number))
    if number not in pb.Mode.values():
        return int(S.BadOutOfRange)
    return "set_mode", pb.Command(set_mode=pb.SetMode(mode=number))


def called(method: Method, inputs: list[ua.Variant]) -> pb.Command | tuple[int, list[int]]:
    """Return the command of a call, or the refusal as (status code, one code per argument)."""
    declared = method.arguments
    if len(inputs) != len(declared):
        return int(S.BadArgumentsMissing if len(inputs) < len(declared) else S.BadTooManyArguments), []
    command = pb.Command()
    what: Any = getattr(command, method.act)
    what.SetInParent()
    codes: list[int] = []
    for argument, supplied in zip(declared, inputs, strict=True):
        code = int(S.Good) if is_of(supplied, argument.variant, is_array=argument.is_array) else int(S.BadTypeMismatch)
        if code == S.Good:
            try:
                if argument.is_array:
                    getattr(what, argument.name).extend(supplied.Value)
                elif supplied.Value is not None:  # a null string is OPC UA's way to leave it empty
                    setattr(what, argument.name, supplied.Value)
            except ValueError:
                code = int(S.BadOutOfRange)
        codes.append(code)
    if any(code != S.Good for code in codes):
        return int(S.BadInvalidArgument), codes
    return command


def is_of(supplied: ua.Variant, variant: ua.VariantType, *, is_array: bool) -> bool:
    """Return whether a value has exactly that type: a server converts nothing (Part 4, 5.11.4 and 5.12.2).

    A Float that was meant as a Double is 3.0000000260770321e-3 m where the sender wrote 3 mm.
    """
    if supplied.Value is None:
        return variant in _NULLABLE and supplied.VariantType in (variant, ua.VariantType.Null)
    return supplied.VariantType is variant and isinstance(supplied.Value, list) == is_array and not supplied.Dimensions
