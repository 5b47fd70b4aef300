"""Users and rights of sessions: asyncua's server with additional security checks and limits.

Rule 1: on a secured server a session without an encrypted channel is refused, whatever its credentials.  asyncua
        accepts an unencrypted channel even if no endpoint offers one.
Rule 2: a session stays with its channel.  asyncua numbers its session tokens.  A client that guesses one would get the
        session and rights of another user before its own credentials are checked.
Rule 3: nothing can be written but setpoints, nothing called but what `model.py` lists, nothing added to the space.
Rule 4: every client gets a bounded service: sessions, logins, queues, bytes that it has not read; see subscriptions.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User as Account
from asyncua.crypto.permission_rules import UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession

from gateway.access.roles import may
from gateway.access.users import User
from gateway.board.limits import MAX_SHELVE_S
from gateway.views.opcua.address_space.model import methods
from gateway.views.opcua.address_space.values import check_timestamps, stamped
from gateway.views.opcua.condition_events import ConditionNode
from gateway.views.opcua.operations import NOBODY, OUTPUTS, SETPOINTS, Operations, called, code_of, is_of, written
from gateway.views.opcua.subscriptions import BoundedSubscriptions
from gateway.views.opcua.types import RIG_TYPE, Namespaces
from protocol.bus import board51_pb2 as pb

S = ua.StatusCodes
MAX_SUBSCRIPTIONS = 100
MAX_CONNECTIONS = 64
MAX_QUEUE = 1_000  # values that wait for one item
MAX_UNREAD_BYTES = 8_000_000  # of one client that does not read
LONGEST_COMMENT = 200  # characters that the gateway takes; the rest of a longer one is cut
_NOBODY = Account(role=UserRole.Anonymous)  # until the session is activated
_METHODS = {method.name: method for method in methods()}
_V = ua.VariantType
# Methods of Part 9 by node id, and the types of their arguments.
_OF_CONDITIONS: dict[ua.NodeId, tuple[str, tuple[ua.VariantType, ...]]] = {
    ua.NodeId(getattr(ua.ObjectIds, method)): (name, types)
    for method, name, types in (
        ("ConditionType_ConditionRefresh", "refresh", (_V.UInt32,)),
        ("ConditionType_ConditionRefresh2", "refresh", (_V.UInt32, _V.UInt32)),
        ("AcknowledgeableConditionType_Acknowledge", "acknowledge", (_V.ByteString, _V.LocalizedText)),
        ("ConditionType_AddComment", "comment", (_V.ByteString, _V.LocalizedText)),
        ("ConditionType_Enable", "enable", ()),
        ("ConditionType_Disable", "disable", ()),
        ("ShelvedStateMachineType_TimedShelve", "shelve", (_V.Double,)),
        ("ShelvedStateMachineType_OneShotShelve", "one-shot", ()),
        ("ShelvedStateMachineType_Unshelve", "unshelve", ()),
        ("AlarmConditionType_ShelvingState_TimedShelve", "shelve", (_V.Double,)),
        ("AlarmConditionType_ShelvingState_OneShotShelve", "one-shot", ()),
        ("AlarmConditionType_ShelvingState_Unshelve", "unshelve", ()),
    )
}


@dataclass
class Guest(Account):
    """A user of asyncua that holds a user of this product."""

    visitor: User | None = None


Identify = Callable[[str | None, str | None, bytes | None, str], User | None]


class GuardedServer(InternalServer):
    """asyncua's internal server and user manager with our sessions and limits.

    `identify` says from (name, password, certificate, host) who it is, or None for nobody who may in.  Sessions of a
    `secured` server need an encrypted channel.
    """

    def __init__(self, identify: Identify, operations: Operations, *, secured: bool) -> None:
        super().__init__(user_manager=self)
        self._identify = identify
        self.peer_host = ""  # of the session that is being activated; asyncua does not say it to a user manager
        self.operations, self.secured = operations, secured
        self.spaces = Namespaces(site=0, types=0, machinery=0)  # until they are registered
        self.conditions: dict[ua.NodeId, ConditionNode] = {}
        self.subscription_service = BoundedSubscriptions(self.aspace, iserver=self)
        self.isession.subscription_service = self.subscription_service
        self.allow_remote_admin = False
        self.max_connections = MAX_CONNECTIONS
        self.max_subscriptions = MAX_SUBSCRIPTIONS
        self.max_monitored_item_queue_size = MAX_QUEUE
        self.max_unacked_messages_per_subscription = 100
        self.max_pending_messages_per_connection = 100
        self.max_pending_activation_seconds = 10.0
        self.max_session_timeout_ms = 120_000.0
        self.max_lifetime_count, self.max_keep_alive_count = 15_000, 1_000  # three times, as Part 4 asks

    def create_session(self, name: str, user: Account = _NOBODY, external: bool = False) -> InternalSession:
        """Return a new GuardedSession."""
        return GuardedSession(self, self.aspace, self.subscription_service, name, user=user, external=external)

    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> Guest | None:
        """Return the guest; None means BadUserAccessDenied."""
        visitor = self._identify(username, password, certificate, self.peer_host)
        return None if visitor is None else Guest(role=UserRole.User, name=visitor.name, visitor=visitor)

    def lookup_external_session(self, auth_token: ua.NodeId) -> InternalSession | None:
        """Return None (rule 2)."""
        return None

    def register_server(self, server: Any, conf: Any = None) -> None:
        """Refuse: this is not a discovery server, and anybody could fill its list."""
        raise ServiceError(S.BadServiceUnsupported)

    def drop_deaf(self) -> int:
        """Close the connections of clients that do not read; return their number."""
        deaf = [t for t in self.asyncio_transports if t.get_write_buffer_size() > MAX_UNREAD_BYTES]
        for transport in deaf:
            transport.abort()
        return len(deaf)


def _own_subscriptions_only(
    service: str, ids: Callable[[Any], list[int]] = lambda params: [params.SubscriptionId]
) -> Callable[..., Any]:
    """Return a service of asyncua that refuses the subscriptions of other sessions."""
    inherited = getattr(InternalSession, service)

    async def guarded(session: GuardedSession, params: Any) -> Any:
        if hasattr(params, "TimestampsToReturn"):
            check_timestamps(params.TimestampsToReturn)
        if any(map(session.is_foreign, ids(params))):
            raise ServiceError(S.BadSubscriptionIdInvalid)
        return await inherited(session, params)

    return guarded


class GuardedSession(InternalSession):
    """The session of one client."""

    iserver: GuardedServer

    _certificate = b""

    async def create_session(
        self, params: ua.CreateSessionParameters, sockname: tuple[str, int] | None = None
    ) -> ua.CreateSessionResult:
        """Open a session and keep its certificate: asyncua does not check clients that send none."""
        self._certificate = params.ClientCertificate or b""
        if self.iserver.secured and not self._certificate:
            raise ServiceError(S.BadCertificateInvalid)
        return await super().create_session(params, sockname=sockname)

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Refuse a channel without encryption, or with another certificate than the checked one."""
        if self.iserver.secured:
            if not peer_certificate:  # empty on an unencrypted channel
                raise ServiceError(S.BadSecurityModeInsufficient)
            if not self._certificate.startswith(peer_certificate):  # a chain begins with it
                raise ServiceError(S.BadCertificateInvalid)
        self.iserver.peer_host = str((self.name or ("",))[0])  # named after its peer: (address, port)
        return super().activate_session(params, None)  # an X509 token brings its own, verified by then

    @property
    def visitor(self) -> User:
        """Return the user of the session."""
        visitor = self.user.visitor if isinstance(self.user, Guest) else None
        return visitor if visitor is not None else NOBODY

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        """Read values, with the requested timestamps."""
        check_timestamps(params.TimestampsToReturn)
        values = await super().read(params)
        now = datetime.now(UTC)
        return [
            stamped(value, params.TimestampsToReturn, now, of_value=item.AttributeId == ua.AttributeIds.Value)
            for item, value in zip(params.NodesToRead, values, strict=True)
        ]

    async def history_read(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Read histories, with the requested timestamps."""
        check_timestamps(params.TimestampsToReturn, of_history=True)
        results: list[ua.HistoryReadResult] = await super().history_read(params)
        return results

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Write setpoints, as commands."""
        return [ua.StatusCode(await self._write(item)) for item in params.NodesToWrite]

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call methods, as commands."""
        return [await self._call(request) for request in params]

    async def add_nodes(self, params: Any) -> list[Any]:
        """Refuse: nobody may add nodes."""
        raise ServiceError(S.BadUserAccessDenied)

    async def transfer_subscriptions(self, params: Any, callback: Any) -> list[Any]:
        """Refuse: a session must not take over the subscriptions of another one."""
        raise ServiceError(S.BadServiceUnsupported)

    async def browse_next(self, parameters: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        """Refuse: Browse returns everything at once, so there is never a rest."""
        raise ServiceError(S.BadNoContinuationPoints)

    create_monitored_items = _own_subscriptions_only("create_monitored_items")
    modify_monitored_items = _own_subscriptions_only("modify_monitored_items")
    set_monitoring_mode = _own_subscriptions_only("set_monitoring_mode")
    delete_monitored_items = _own_subscriptions_only("delete_monitored_items")
    set_publishing_mode = _own_subscriptions_only("set_publishing_mode", lambda params: params.SubscriptionIds)
    delete_subscriptions = _own_subscriptions_only("delete_subscriptions", lambda ids: ids)

    def is_foreign(self, number: int) -> bool:
        """Return whether a subscription belongs to another session."""
        subscription = self.subscription_service.subscriptions.get(number)
        return subscription is not None and subscription.session_id != self.session_id

    def _address_of(self, node: ua.NodeId) -> tuple[str, str]:
        """Return (board, path) of a node of the site, ("", "") of any other."""
        if node.NamespaceIndex != self.iserver.spaces.site or not isinstance(node.Identifier, str):
            return "", ""
        board, _, path = node.Identifier.partition("/")
        return board, path

    def _method(self, rig: ua.NodeId, method: ua.NodeId) -> tuple[str, str]:
        """Return (board, name) of a method; a method of RigType may be called at every rig (Part 4, 5.12.2)."""
        owner, _, name = str(method.Identifier).partition("/")
        if method.NamespaceIndex == self.iserver.spaces.types and owner == RIG_TYPE:
            board, path = self._address_of(rig)
            return ("", "") if path or rig not in self.aspace else (board, name)
        return self._address_of(method)

    async def _write(self, item: ua.WriteValue) -> int:
        board, path = self._address_of(item.NodeId)
        if item.NodeId not in self.aspace:
            return int(S.BadNodeIdUnknown)
        folder, _, name = path.partition("/")
        if item.AttributeId != ua.AttributeIds.Value or folder != "setpoint" or name not in SETPOINTS:
            return int(S.BadNotWritable)
        if item.IndexRange:
            return int(S.BadIndexRangeInvalid)
        command = written(name, item.Value)
        if isinstance(command, int):
            return command
        return code_of(await self.iserver.operations.command(self.visitor, board, *command))

    async def _call(self, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        inputs = request.InputArguments or []
        if request.MethodId in _OF_CONDITIONS:
            return _result(*await self._call_of_condition(request.ObjectId, *_OF_CONDITIONS[request.MethodId], inputs))
        board, name = self._method(request.ObjectId, request.MethodId)
        is_of_board = request.MethodId in self.aspace and request.ObjectId == ua.NodeId(board, self.iserver.spaces.site)
        if not is_of_board or name not in _METHODS:
            return _result(S.BadMethodInvalid)
        command = called(_METHODS[name], inputs)
        if not isinstance(command, pb.Command):
            return _result(*command)
        reply = await self.iserver.operations.command(self.visitor, board, _METHODS[name].act, command)
        outputs = [ua.Variant(getattr(reply, name), variant) for name, variant in OUTPUTS.items()]
        return _result(code_of(reply), outputs=outputs)

    async def _call_of_condition(
        self, node: ua.NodeId, name: str, types: tuple[ua.VariantType, ...], inputs: list[ua.Variant]
    ) -> tuple[int, list[int]]:
        """Call a method of a condition (Part 9, 5.5.4 to 5.5.8 and 5.7.3).

        Return the status code, and one code for each argument if any argument is wrong.
        """
        if len(inputs) != len(types):
            return int(S.BadArgumentsMissing if len(inputs) < len(types) else S.BadTooManyArguments), []
        fit = [is_of(supplied, variant, is_array=False) for supplied, variant in zip(inputs, types, strict=True)]
        if not all(fit):
            return int(S.BadInvalidArgument), [int(S.Good if fits else S.BadTypeMismatch) for fits in fit]
        values = [supplied.Value for supplied in inputs]
        if name == "refresh":
            if self.is_foreign(values[0]):
                return int(S.BadSubscriptionIdInvalid), []
            return await self.iserver.subscription_service.refresh(*values), []
        if name in ("shelve", "one-shot", "unshelve"):
            return await self._shelve(node, name, *values), []
        condition = self.iserver.conditions.get(node)
        if condition is None:
            return int(S.BadNodeIdUnknown), []
        if name in ("enable", "disable"):
            return await self._enable(condition, enabled=name == "enable"), []
        if not condition.enabled:
            return int(S.BadConditionDisabled), []
        if values[0] not in condition.event_ids:
            return int(S.BadEventIdUnknown), []
        comment = ((values[1].Text if values[1] is not None else None) or "")[:LONGEST_COMMENT]
        if name == "acknowledge":
            command = pb.Command(acknowledge=pb.Acknowledge(alarm=condition.alarm, comment=comment))
            code = code_of(await self.iserver.operations.command(self.visitor, condition.board, name, command))
            condition.comment = condition.comment if code != S.Good else None  # its comment is the newer one
            return code, []
        code = await self._remark(condition, f"{condition.alarm}: {comment}")
        if code == S.Good:
            condition.comment, condition.is_changed = (comment, self.visitor.name), True
        return code, []

    async def _shelve(self, node: ua.NodeId, name: str, duration_ms: float = 0.0) -> int:
        """Shelve or unshelve an alarm (Part 9, 5.8.17); `node` is its ShelvingState or the condition itself."""
        path = str(node.Identifier).removesuffix("/ShelvingState")
        condition = self.iserver.conditions.get(ua.NodeId(path, node.NamespaceIndex))
        if condition is None:
            return int(S.BadNodeIdUnknown)
        if not condition.enabled:
            return int(S.BadConditionDisabled)
        if name == "one-shot":  # on the bus a shelving has an end: nobody forgets an alarm that stays away
            return int(S.BadNotSupported)
        if name == "unshelve" and condition.unshelved_at is None:
            return int(S.BadConditionNotShelved)
        if name == "shelve" and not 0.0 < duration_ms <= 1e3 * MAX_SHELVE_S:
            return int(S.BadShelvingTimeOutOfRange)
        what = pb.Command(acknowledge=pb.Acknowledge(alarm=condition.alarm, shelve_s=duration_ms / 1e3))
        return code_of(await self.iserver.operations.command(self.visitor, condition.board, "acknowledge", what))

    async def _enable(self, condition: ConditionNode, *, enabled: bool) -> int:
        if condition.enabled == enabled:
            return int(S.BadConditionAlreadyEnabled if enabled else S.BadConditionAlreadyDisabled)
        if not may(self.visitor.role, "disable_alarm"):  # the bus has no such command: the right is checked here
            return int(S.BadUserAccessDenied)
        state = "enabled" if enabled else "disabled"
        code = await self._remark(condition, f"{condition.alarm} {state} for OPC UA clients")
        if code == S.Good:
            condition.enabled, condition.is_changed = enabled, True
        return code

    async def _remark(self, condition: ConditionNode, text: str) -> int:
        """Send a remark to the log and every view; the action fails if it cannot be recorded."""
        remark = pb.Command(mark=pb.Mark(text=text[:LONGEST_COMMENT]))
        return code_of(await self.iserver.operations.command(self.visitor, condition.board, "mark", remark))


def _result(code: int, codes: Sequence[int] = (), outputs: Sequence[ua.Variant] = ()) -> ua.CallMethodResult:
    """Return the status code of a call, with a code for each argument or with the outputs."""
    return ua.CallMethodResult(
        StatusCode=ua.StatusCode(code),
        InputArgumentResults=[ua.StatusCode(code) for code in codes],
        OutputArguments=list(outputs),
    )
