"""Fixtures that are slow to make and serve many tests of views: a server takes 2 s of processor time to start."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from gateway.access.roles import Role
from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.api_peers import ApiServer, api_server
from tests.harness.gateway.bus_peers import played_gateway
from tests.harness.gateway.chromium import chromium
from tests.harness.gateway.hmi_server import Server, hmi_with_logins
from tests.harness.gateway.opcua_peers import Served


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    # Not for all modules: while it is open, no other test of the process can run an event loop.
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="package")
def hmi_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with hmi_with_logins(tmp_path_factory.mktemp("hmi")) as server:
        yield server


@pytest.fixture(scope="package")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiServer]:
    with api_server(tmp_path_factory.mktemp("api")) as server:
        yield server


@pytest.fixture(scope="package")
def opcua_server() -> Iterator[Served]:
    """Provide an OPC UA server at 50 Hz; anonymous clients may command, as on a loopback that somebody opened."""
    with (
        played_gateway() as gateway,
        Served(gateway, OpcuaSettings(port=0, rate_hz=50.0, anonymous=Role.ENGINEER)) as served,
    ):
        yield served


@pytest.fixture
def server(opcua_server: Served) -> Served:
    """Provide `opcua_server`; the gateway behind it accepts everything and remembers no command of another test."""
    opcua_server.gateway.answer = lambda _, command: pb.CommandReply(id=command.id, accepted=True, tick=7)
    opcua_server.gateway.commands.clear()
    return opcua_server
