"""The OPC UA server process: bus on one side, asyncua on the other.

Secured (a folder made by `board51 security init`): Basic256Sha256, Aes128Sha256RsaOaep and Aes256Sha256RsaPss, sign and
encrypt only; users by password or certificate; anonymous off.  Without security: loopback only, and everybody on this
machine may command, as on the bus (gateway/commands/views/opcua.py decides).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import Server, ua
from asyncua.server import binary_server_asyncio
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import nodeid_from_binary

from gateway.access.listeners import try_listening
from gateway.access.roles import Role
from gateway.access.users import User
from gateway.views.feed import Feed
from gateway.views.opcua.address_space.history import RingHistory
from gateway.views.opcua.capabilities import describe
from gateway.views.opcua.conditions import Conditions
from gateway.views.opcua.nodes import BoardNodes
from gateway.views.opcua.operations import Operations
from gateway.views.opcua.security import Security
from gateway.views.opcua.sessions import GuardedServer
from gateway.views.opcua.types import Builder, register
from protocol.errors import ServiceError

APPLICATION_URI = "urn:board51:gateway:opcua"
NAMESPACE = "urn:board51:{site}"
POLICIES = (
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)
_OPEN = (ua.SecurityPolicyType.NoSecurity,)
MAX_ACTS = 64  # of one connection at once; further requests wait for one of them
_ACTS = (
    ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary),
    ua.NodeId(ua.ObjectIds.WriteRequest_Encoding_DefaultBinary),
)
LOOK_S = 1.0  # for new boards, deaf clients
_logger = logging.getLogger("gateway.opcua")


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcuaSettings:
    """The settings of the OPC UA server."""

    host: str = "127.0.0.1"
    port: int = 4840
    rate_hz: float = 20.0
    history_s: float = 300.0
    anonymous: Role | None = Role.VIEWER  # what a client without a name may; None: it may not in
    security: Security | None = None


async def serve(feed: Feed, settings: OpcuaSettings, stop: asyncio.Event, ready: Callable[[int], None]) -> None:
    """Serve until `stop` is set; `ready` is called with the port once clients may come.

    Raises:
        ServiceError: the port is taken.
    """
    try:  # first: the address space takes seconds to build, and asyncua tells of a taken port with a traceback
        try_listening(settings.host, settings.port)
    except OSError as error:
        raise _listen_error(settings, error) from None
    security = settings.security
    anonymous = User(name="anonymous", role=settings.anonymous) if settings.anonymous is not None else None

    def identify(name: str | None, password: str | None, certificate: bytes | None, host: str) -> User | None:
        if name is None and certificate is None:
            return anonymous
        return security.identify(name, password, certificate, host) if security is not None else None

    inner = GuardedServer(identify, Operations(feed), secured=security is not None)
    binary_server_asyncio.UaProcessor = PromptProcessor  # asyncua offers no other way to choose the class
    server = Server(iserver=inner)
    await server.init()
    server.set_endpoint(f"opc.tcp://{settings.host}:{settings.port}/board51/")
    server.set_server_name(f"Board51 {feed.site}")
    await server.set_build_info("urn:board51:gateway", "Board51", "Board51 OPC UA", "0.1", "0", datetime.now(UTC))
    tokens: list[type] = [ua.AnonymousIdentityToken] if anonymous is not None else []
    if security is not None:
        await server.set_application_uri(security.application_uri)
        await server.load_certificate(security.certificate_der, format="der")
        await server.load_private_key(security.key_pem, format="pem")
        server.set_certificate_validator(security.check_client)
        server.set_security_policy(list(POLICIES))
        tokens += [ua.UserNameIdentityToken, ua.X509IdentityToken]
    else:
        await server.set_application_uri(APPLICATION_URI)
        server.set_security_policy(list(_OPEN))
    server.set_identity_tokens(tokens)
    await describe(server, POLICIES if security is not None else _OPEN, tokens, 1000.0 / settings.rate_hz)
    await server.register_namespace(NAMESPACE.format(site=feed.site))
    inner.spaces = await register(server)
    history = inner.history_manager = RingHistory(inner)
    try:
        await server.start()
    except OSError as error:
        raise _listen_error(settings, error) from None
    try:
        port = server.bserver.port if server.bserver is not None else settings.port
        _logger.info("OPC UA on opc.tcp://%s:%s/board51/%s", settings.host, port, "" if security else ", not secured")
        ready(int(port or 0))
        await _keep_up(feed, inner, history, settings, stop)
    finally:
        await server.stop()


async def _keep_up(
    feed: Feed, inner: GuardedServer, history: RingHistory, settings: OpcuaSettings, stop: asyncio.Event
) -> None:
    builder = Builder(inner, inner.spaces)
    site = builder.object(
        ua.NodeId(ua.ObjectIds.ObjectsFolder), feed.site, "the site", reference=ua.ObjectIds.Organizes
    )
    boards: dict[str, tuple[BoardNodes, Conditions]] = {}
    period_s = 1.0 / settings.rate_hz
    due_s = look_s = time.monotonic()
    while not stop.is_set():
        for name in feed.boards():
            board = feed.board(name)
            if name not in boards and board is not None:
                nodes = BoardNodes(
                    inner, builder, site, board, rate_hz=settings.rate_hz, history=history, history_s=settings.history_s
                )
                boards[name] = nodes, Conditions(inner, builder, board, nodes.object)
                _logger.info("%s is served", name)
                await asyncio.sleep(0)  # a board's 361 nodes take a while: who is connected is answered in between
        for nodes, conditions in boards.values():
            await nodes.update()
            await conditions.update()
            await asyncio.sleep(0)  # however much there is to send: between two boards clients are answered
        now_s = time.monotonic()
        if now_s - look_s > LOOK_S:
            look_s = now_s
            if deaf := inner.drop_deaf():
                _logger.warning("%d clients did not read and were dropped", deaf)
        due_s = max(due_s + period_s, now_s)  # missed rounds are not repeated: the bins are complete
        try:
            await asyncio.wait_for(stop.wait(), max(0.0, due_s - now_s))
        except TimeoutError:
            continue


def _listen_error(settings: OpcuaSettings, error: OSError) -> ServiceError:
    return ServiceError(
        f"OPC UA cannot listen on {settings.host}:{settings.port}: {error.strerror or error}",
        remedy="End the program that uses the port, or give another one with --listen HOST:PORT",
    )


class PromptProcessor(UaProcessor):
    """Handles each call and write in a task of its own, which ends with the connection: it delays no other request.

    asyncua handles the requests of a connection one after the other.  A write to a board that does not answer takes
    seconds, and a STOP behind it would wait as long.  A SCADA system has one connection for all of its rigs.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._acts: set[asyncio.Task[Any]] = set()

    async def process_message(self, seqhdr: Any, body: Any) -> Any:
        """Handle one request; returns whether the connection stays."""
        if self.session is None or nodeid_from_binary(body.copy()) not in _ACTS:
            return await super().process_message(seqhdr, body)
        if len(self._acts) >= MAX_ACTS:
            await asyncio.wait(self._acts, return_when=asyncio.FIRST_COMPLETED)
        task = asyncio.create_task(super().process_message(seqhdr, body))
        self._acts.add(task)
        task.add_done_callback(self._acts.discard)
        return True

    async def close(self) -> None:
        """Cancel the commands that have not begun: their client has left."""
        for task in self._acts:
            task.cancel()
        await super().close()
