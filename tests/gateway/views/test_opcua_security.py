"""A secured OPC UA server: who gets in, as whom, and what is tried and refused."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.security_policies import (
    SecurityPolicy,
    SecurityPolicyAes128Sha256RsaOaep,
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256Sha256,
)
from asyncua.ua.uaerrors import UaError
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from gateway.access.certificates import Authority
from gateway.access.folder import SecurityFolder
from gateway.access.roles import Role
from gateway.access.tries import BURST
from gateway.access.users import User
from gateway.views.opcua.security import Security
from gateway.views.opcua.server import OpcuaSettings
from protocol.errors import ConfigError
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.opcua_peers import NAMESPACE, Peer, Served
from tests.patience import HANG_S

S = ua.StatusCodes
DOUBLE = ua.VariantType.Double
PASSWORD = {"vera": "look-only-1", "otto": "fly-it-now-2", "emma": "tune-it-too-3"}
ROLES = {"vera": Role.VIEWER, "otto": Role.OPERATOR, "emma": Role.ENGINEER}


@dataclass(frozen=True, kw_only=True)
class Plant:
    folder: Path
    server: Served
    security: Security


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    path = tmp_path_factory.mktemp("plant") / "security"
    folder = SecurityFolder(path)
    folder.init()
    for name, role in ROLES.items():
        folder.add_user(User(name=name, role=role), PASSWORD[name])
    with played_gateway() as gateway, ticking(gateway, "rig"):
        security = Security(path)
        with Served(gateway, OpcuaSettings(port=0, anonymous=None, security=security)) as server:
            yield Plant(folder=path, server=server, security=security)


async def enter(
    plant: Plant,
    name: str | None = "otto",
    password: str | None = None,
    *,
    policy: type[SecurityPolicy] = SecurityPolicyBasic256Sha256,
    certificate_of: str = "otto",
    with_certificate: bool = False,
) -> Client:
    """A client that is in, or an exception."""
    client = Client(f"opc.tcp://127.0.0.1:{plant.server.port}/board51/", timeout=HANG_S)
    identity = plant.folder / "identities" / certificate_of
    client.application_uri = "urn:test:client"
    await client.set_security(
        policy,
        identity / "certificate.pem",
        identity / "key.pem",
        server_certificate=plant.folder / "opcua" / "server.pem",
        mode=ua.MessageSecurityMode.SignAndEncrypt,
    )
    if with_certificate:
        await client.load_client_certificate(identity / "certificate.pem")
        await client.load_private_key(identity / "key.pem")
    elif name is not None:
        client.set_user(name)
        client.set_password(PASSWORD[name] if password is None else password)
    await client.connect()
    return client


async def acts(client: Client) -> dict[str, int]:
    """Status of a read, a stop, a reference and gains."""
    peer = Peer(client, await client.get_namespace_index(NAMESPACE))
    await peer.await_status("rig/state/x_m", S.Good)
    law = ua.Variant(0, ua.VariantType.UInt32)
    gains = [law, ua.Variant([0.5, 1.0, 1.0, 1.0])] + [ua.Variant(v, DOUBLE) for v in (0.6, 2.8e-3, 2.1)]
    return {
        "stop": (await peer.call("rig", "Stop")).StatusCode.value,
        "reference": await peer.write("rig/setpoint/x_ref_m", ua.Variant(3e-3, DOUBLE)),
        "gains": (await peer.call("rig", "SetGains", *gains)).StatusCode.value,
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "policy", [SecurityPolicyBasic256Sha256, SecurityPolicyAes128Sha256RsaOaep, SecurityPolicyAes256Sha256RsaPss]
)
def test_an_operator_comes_in_by_password_over_each_policy(plant: Plant, policy: type[SecurityPolicy]) -> None:
    async def session_work() -> dict[str, int]:
        async with await entered(plant, "otto", policy=policy) as client:
            return await acts(client)

    plant.server.gateway.commands.clear()

    assert asyncio.run(session_work()) == {"stop": S.Good, "reference": S.Good, "gains": S.BadUserAccessDenied}
    assert {command.who for _, command in plant.server.gateway.commands} == {"otto"}


async def entered(plant: Plant, *args: Any, **options: Any) -> _Entered:
    return _Entered(await enter(plant, *args, **options))


class _Entered:
    def __init__(self, client: Client) -> None:
        self._client = client

    async def __aenter__(self) -> Client:
        return self._client

    async def __aexit__(self, *_: object) -> None:
        await self._client.disconnect()


@pytest.mark.parametrize(
    ("name", "allowed"), [("vera", {"stop"}), ("emma", {"stop", "reference", "gains"})], ids=["viewer", "engineer"]
)
def test_rights_are_those_of_the_role(plant: Plant, name: str, allowed: set[str]) -> None:
    async def session_work() -> dict[str, int]:
        async with await entered(plant, name) as client:
            return await acts(client)

    codes = asyncio.run(session_work())

    assert {act for act, code in codes.items() if code == S.Good} == allowed
    assert {code for code in codes.values() if code != S.Good} <= {S.BadUserAccessDenied}


def test_a_person_comes_in_by_certificate(plant: Plant) -> None:
    async def session_work() -> dict[str, int]:
        async with await entered(plant, None, certificate_of="emma", with_certificate=True) as client:
            return await acts(client)

    assert asyncio.run(session_work())["gains"] == S.Good


def refused(plant: Plant, *args: Any, **options: Any) -> str:
    async def session_work() -> None:
        client = await enter(plant, *args, **options)
        await client.disconnect()

    with pytest.raises((UaError, ConnectionError, asyncio.TimeoutError)) as error:
        asyncio.run(session_work())
    return type(error.value).__name__


def test_a_wrong_password_is_refused(plant: Plant) -> None:
    assert refused(plant, "vera", "guess-1") == "BadUserAccessDenied"


def test_nobody_without_a_name(plant: Plant) -> None:
    assert refused(plant, None) in ("BadIdentityTokenRejected", "BadIdentityTokenInvalid")


def test_a_client_that_the_authority_did_not_sign_is_refused(plant: Plant, tmp_path: Path) -> None:
    strange = stranger(plant, tmp_path)

    assert refused(replace(plant, folder=strange), "otto", certificate_of="eve") == "BadCertificateUntrusted"


def stranger(plant: Plant, tmp_path: Path) -> Path:
    """A folder like the plant's with an identity `eve`, whose certificate another authority made for "otto"."""
    now = datetime.now(UTC)
    authority, _ = Authority.create("somebody else", now=now)
    issued = authority.issue("otto", now=now, uris=["urn:test:client"])
    folder = tmp_path / "strange"
    (folder / "identities" / "eve").mkdir(parents=True)
    (folder / "identities" / "eve" / "certificate.pem").write_bytes(issued.certificate)
    (folder / "identities" / "eve" / "key.pem").write_bytes(issued.key)
    (folder / "opcua").mkdir()
    (folder / "opcua" / "server.pem").write_bytes((plant.folder / "opcua" / "server.pem").read_bytes())
    return folder


def test_a_trusted_certificate_of_another_authority_is_let_in(plant: Plant, tmp_path: Path) -> None:
    folder = stranger(plant, tmp_path)
    trusted = plant.folder / "opcua" / "trusted"
    trusted.mkdir()
    (trusted / "scada.pem").write_bytes((folder / "identities" / "eve" / "certificate.pem").read_bytes())

    async def session_work() -> dict[str, int]:
        strange = replace(plant, folder=folder)
        async with await entered(strange, "otto", certificate_of="eve") as client:
            return await acts(client)

    try:
        assert asyncio.run(session_work())["stop"] == S.Good
        # Trusted as an application, it is nobody's login: the name in it is not its own to give.
        assert refused(replace(plant, folder=folder), None, certificate_of="eve", with_certificate=True) in (
            "BadUserAccessDenied",
            "BadIdentityTokenRejected",
        )
    finally:
        (trusted / "scada.pem").unlink()
        trusted.rmdir()


def test_the_right_password_over_an_unencrypted_channel_is_refused(plant: Plant) -> None:
    """No endpoint offers it, but asyncua's server opens such a channel all the same."""

    async def session_work() -> None:
        client = Client(f"opc.tcp://127.0.0.1:{plant.server.port}/board51/", timeout=HANG_S)
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            parameters = ua.CreateSessionParameters()
            parameters.ClientNonce, parameters.RequestedSessionTimeout = bytes(32), 60_000
            parameters.ClientCertificate = der(plant, "otto")
            await client.uaclient.create_session(parameters)
            token = ua.UserNameIdentityToken(UserName="otto", Password=PASSWORD["otto"].encode())
            await client.uaclient.activate_session(ua.ActivateSessionParameters(UserIdentityToken=token))
        finally:
            client.disconnect_socket()

    with pytest.raises(UaError) as error:
        asyncio.run(session_work())

    assert type(error.value).__name__ == "BadSecurityModeInsufficient"


def der(plant: Plant, name: str) -> bytes:
    """A certificate is no secret: everybody can send somebody else's."""
    pem = (plant.folder / "identities" / name / "certificate.pem").read_bytes()
    return x509.load_pem_x509_certificate(pem).public_bytes(Encoding.DER)


@pytest.mark.parametrize("certificate", ["none", "otto's"])
def test_a_channel_by_another_certificate_than_the_one_shown_is_refused(
    plant: Plant, tmp_path: Path, certificate: str
) -> None:
    async def session_work() -> None:
        strange = stranger(plant, tmp_path) / "identities" / "eve"
        server = plant.folder / "opcua" / "server.pem"
        client = Client(f"opc.tcp://127.0.0.1:{plant.server.port}/board51/", timeout=HANG_S)
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            strange / "certificate.pem",
            strange / "key.pem",
            server_certificate=server,
            mode=ua.MessageSecurityMode.SignAndEncrypt,
        )
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            parameters = ua.CreateSessionParameters()
            parameters.ClientNonce, parameters.RequestedSessionTimeout = bytes(32), 60_000
            parameters.ClientCertificate = der(plant, "otto") if certificate == "otto's" else None
            session = await client.uaclient.create_session(parameters)
            challenge = x509.load_pem_x509_certificate(server.read_bytes()).public_bytes(Encoding.DER)
            activation = ua.ActivateSessionParameters()
            activation.ClientSignature.Algorithm = client.security_policy.AsymmetricSignatureURI
            signature = client.security_policy.asymmetric_cryptography.signature(challenge + session.ServerNonce)
            activation.ClientSignature.Signature = signature
            activation.UserIdentityToken = ua.UserNameIdentityToken(UserName="otto", Password=PASSWORD["otto"].encode())
            await client.uaclient.activate_session(activation)
        finally:
            client.disconnect_socket()

    with pytest.raises(UaError) as error:
        asyncio.run(session_work())

    assert type(error.value).__name__ == "BadCertificateInvalid"


def test_guessing_a_session_does_not_give_its_rights(plant: Plant) -> None:
    """asyncua's tokens are counted up; whoever names one must not be taken for its owner."""

    async def session_work() -> list[str]:
        async with await entered(plant, "emma", certificate_of="emma") as owner:
            tokens = [owner.uaclient.protocol.authentication_token]
            await owner.get_namespace_array()
            thief = Client(f"opc.tcp://127.0.0.1:{plant.server.port}/board51/", timeout=HANG_S)
            await thief.connect_socket()
            await thief.send_hello()
            await thief.open_secure_channel()
            thief.uaclient.protocol.authentication_token = tokens[0]
            answers = []
            parameters = ua.ActivateSessionParameters()
            parameters.UserIdentityToken = ua.UserNameIdentityToken(UserName="vera", Password=b"wrong")
            for attempt in (
                lambda: thief.uaclient.activate_session(parameters),
                lambda: Peer(thief, 2).call("rig", "Stop"),
            ):
                try:
                    answers.append(str(await attempt()))
                except UaError as error:
                    answers.append(type(error).__name__)
            thief.disconnect_socket()
            return answers

    plant.server.gateway.commands.clear()
    answers = asyncio.run(session_work())

    assert all(name.startswith("Bad") for name in answers), answers
    assert plant.server.gateway.commands == []


def test_a_flood_of_wrong_passwords_is_refused_and_keeps_nobody_out_who_was_in(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = time.monotonic()
    monkeypatch.setattr(plant.security._logins, "_clock", lambda: now_s)  # however slow this machine's flood is

    async def session_work() -> tuple[list[str], dict[str, int]]:
        async with await entered(plant, "otto"):
            pass
        answers = [await answer_to(plant, "vera", f"guess-{n}") for n in range(3 * BURST)]
        async with await entered(plant, "otto") as client:
            return answers, await acts(client)

    answers, codes = asyncio.run(session_work())

    assert set(answers) == {"BadUserAccessDenied", "BadTooManyOperations"}
    assert codes["stop"] == S.Good
    assert ("otto", "127.0.0.1") in plant.security._logins._tries._known


async def answer_to(plant: Plant, name: str, password: str) -> str:
    try:
        client = await enter(plant, name, password)
    except UaError as error:
        return type(error).__name__
    await client.disconnect()
    return "Good"


def test_where_a_login_comes_from_is_the_address_of_its_connection(folder: SecurityFolder) -> None:
    folder.add_user(User(name="otto", role=Role.OPERATOR), PASSWORD["otto"])
    security = Security(folder.path, clock=lambda: 100.0)  # a try takes no time, however busy the machine is

    for _ in range(BURST):
        assert security.identify("otto", "guess", None, "10.0.0.66") is None
    with pytest.raises(ServiceError) as error:
        security.identify("otto", PASSWORD["otto"], None, "10.0.0.66")

    assert error.value.code == S.BadTooManyOperations
    assert security.identify("otto", PASSWORD["otto"], None, "10.0.0.7") is not None


@pytest.fixture
def folder(tmp_path: Path) -> SecurityFolder:
    made = SecurityFolder(tmp_path / "security")
    made.init()
    return made


def test_a_key_that_others_may_read_is_refused(folder: SecurityFolder) -> None:
    os.chmod(folder.server("opcua")[1], 0o644)

    with pytest.raises(ConfigError, match="open to others") as error:
        Security(folder.path)

    assert "chmod 600" in str(error.value)


def test_an_expired_certificate_is_refused(folder: SecurityFolder) -> None:
    folder.renew(now=datetime.now(UTC) - timedelta(days=1000))

    with pytest.raises(ConfigError, match="expired on"):
        Security(folder.path)


def test_a_typo_in_a_role_is_named_with_its_line(folder: SecurityFolder) -> None:
    folder.add_user(User(name="otto", role=Role.OPERATOR), PASSWORD["otto"])
    text = folder.users.read_text().replace('"operator"', '"operater"')
    folder.users.write_text(text)

    with pytest.raises(ConfigError, match=r"operater.*viewer, operator, engineer"):
        Security(folder.path)
