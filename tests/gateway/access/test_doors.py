"""Tests of the clients that are not let onto a guarded bus at all, and of those that are put out of it again."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.access.certificates import Authority, Issued
from gateway.access.folder import SecurityFolder
from gateway.access.private import write_private
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import router_refusal, zenoh_config
from protocol.errors import ConfigError
from tests.harness.gateway.access_peers import Client, GuardedRig, fresh, guarded_rig, join
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port

pytestmark = pytest.mark.xdist_group("guarded-bus")
PATIENCE_S = 0.5  # a router that takes a client takes it within 0.1 s


def tls(config: dict[str, Any]) -> dict[str, Any]:
    settings: dict[str, Any] = config["transport"]["link"]["tls"]
    return settings


def wrong_password(config: dict[str, Any], _: Path) -> None:
    config["transport"]["auth"]["usrpwd"]["password"] = "guess"


def no_password(config: dict[str, Any], _: Path) -> None:
    del config["transport"]["auth"]


def unknown_name(config: dict[str, Any], _: Path) -> None:
    config["transport"]["auth"]["usrpwd"]["user"] = "eve"


def no_certificate(config: dict[str, Any], _: Path) -> None:
    del tls(config)["connect_certificate"], tls(config)["connect_private_key"]


def show(config: dict[str, Any], issued: Issued, folder: Path) -> None:
    for option, name, data in (
        ("connect_certificate", "c.pem", issued.certificate),
        ("connect_private_key", "k.pem", issued.key),
    ):
        write_private(folder / name, data)
        tls(config)[option] = str(folder / name)


def another_authority(config: dict[str, Any], folder: Path) -> None:
    authority, _ = Authority.create("Board51 authority of board51", now=datetime.now(UTC))
    show(config, authority.issue("ben", now=datetime.now(UTC)), folder)


def self_made(config: dict[str, Any], folder: Path) -> None:
    _, issued = Authority.create("ben", now=datetime.now(UTC))
    show(config, issued, folder)


def plain_tcp(config: dict[str, Any], _: Path) -> None:
    config["connect"]["endpoints"] = [e.replace("tls/", "tcp/") for e in config["connect"]["endpoints"]]


@pytest.mark.parametrize(
    "spoil",
    [wrong_password, no_password, unknown_name, no_certificate, another_authority, self_made, plain_tcp],
    ids=lambda spoil: spoil.__name__,
)
def test_a_client_that_cannot_show_who_it_is_stays_outside(
    rig: GuardedRig, tmp_path: Path, spoil: Callable[[dict[str, Any], Path], None]
) -> None:
    ben = rig.folder.identity("ben")

    with (
        pytest.raises(zenoh.ZError),
        join(rig.endpoint, ben, patience_s=PATIENCE_S, change=lambda config: spoil(config, tmp_path)),
    ):
        pass

    with join(rig.endpoint, ben) as honest:
        wait_for(lambda: honest.states, "states for the honest one")


def test_an_expired_certificate_stays_outside(rig: GuardedRig, keys: SecurityFolder, tmp_path: Path) -> None:
    authority = Authority.load(keys.ca.read_bytes(), (keys.path / "ca-key.pem").read_bytes())
    old = authority.issue("ben", now=datetime.now(UTC), days=-1)

    with (
        pytest.raises(zenoh.ZError),
        join(rig.endpoint, keys.identity("ben"), patience_s=PATIENCE_S, change=lambda c: show(c, old, tmp_path)),
    ):
        pass


def test_a_session_ends_when_its_certificate_does(rig: GuardedRig, keys: SecurityFolder, tmp_path: Path) -> None:
    authority = Authority.load(keys.ca.read_bytes(), (keys.path / "ca-key.pem").read_bytes())
    short = authority.issue("ben", now=datetime.now(UTC), days=6.0 / 86400)

    with join(rig.endpoint, keys.identity("ben"), change=lambda config: show(config, short, tmp_path)) as client:
        wait_for(lambda: client.states, "states while it is good")
        wait_for(lambda: not list(client.session.info.routers_zid()), "end of the link")
        before = len(client.states)
        assert client.command(ping=pb.Ping()) is None
        assert len(client.states) == before


@pytest.mark.parametrize("whose", ["identities/ana/certificate", "identities/views/certificate", "bus/router"])
@pytest.mark.parametrize("kind", ["tls", "quic"])
def test_a_password_with_the_certificate_of_somebody_else_gets_nothing(
    keys: SecurityFolder, tmp_path: Path, whose: str, kind: str
) -> None:
    ben, key = keys.identity("ben"), whose.replace("certificate", "key") if "identities" in whose else f"{whose}-key"

    def swap_certificate(config: dict[str, Any]) -> None:
        tls(config)["connect_certificate"] = str(keys.path / f"{whose}.pem")
        tls(config)["connect_private_key"] = str(keys.path / f"{key}.pem")

    with guarded_rig(keys, tmp_path, kind=kind) as rig, rig.join("vic") as honest:
        with join(rig.endpoint, ben, change=swap_certificate) as client:
            assert list(client.session.info.routers_zid()), "the authority signed both, and the password is right"
            assert client.request(fresh(stop=pb.Stop()).SerializeToString(), timeout_s=1.0) == []
            count = len(honest.states)
            wait_for(lambda: len(honest.states) > count + 50, "states for the honest one")

            assert client.states == []
        assert "STOP" not in rig.board.names()
        with join(rig.endpoint, ben) as himself:
            wait_for(lambda: (r := himself.command(ping=pb.Ping())) is not None and r.accepted, "an accepted command")
            assert (reply := himself.command(stop=pb.Stop())) is not None
            assert reply.accepted
        assert "STOP" in rig.board.names()


def test_a_false_router_gets_nobodys_password(keys: SecurityFolder, tmp_path: Path) -> None:
    false, endpoint = SecurityFolder(tmp_path / "false"), f"tls/127.0.0.1:{free_port()}"
    false.init()
    with zenoh.open(zenoh.Config.from_json5(false.router([endpoint]))), pytest.raises(zenoh.ZError):
        with join(endpoint, keys.identity("ben"), patience_s=PATIENCE_S):
            pass


def test_a_session_of_somebody_removed_does_not_come_back(keys: SecurityFolder, tmp_path: Path) -> None:
    shutil.copytree(keys.path, tmp_path / "keys")
    folder = SecurityFolder(tmp_path / "keys")
    with guarded_rig(folder, tmp_path / "one") as rig:
        vic = folder.identity("vic")
        # A daemon's session: it looks for its router again and again.
        text = zenoh_config("client", connect=[rig.endpoint], wait_for_router=False, identity=vic)
        stale = zenoh.open(zenoh.Config.from_json5(text))
        client = Client(stale, vic)
        wait_for(lambda: client.states, "states before")
    with stale:
        folder.remove_user("vic")
        with (
            guarded_rig(folder, tmp_path / "two", endpoint=rig.endpoint),
            join(rig.endpoint, folder.identity("ana")) as ana,
        ):
            before = len(client.states)
            end_s = time.monotonic() + 2.2  # it tries every 2 s at most
            wait_for(lambda: time.monotonic() > end_s and len(ana.states) > 100, "states for others")
            assert len(client.states) == before


def test_on_loopback_without_tls_the_password_decides_alone(keys: SecurityFolder, tmp_path: Path) -> None:
    with guarded_rig(keys, tmp_path, kind="tcp") as rig:
        with rig.join("ben") as ben:
            reply = ben.command(set_gains=pb.SetGains())
            assert reply is not None
            assert reply.reason == "not-allowed"
        with (
            pytest.raises(zenoh.ZError),
            join(
                rig.endpoint,
                keys.identity("ben"),
                patience_s=PATIENCE_S,
                change=lambda config: wrong_password(config, tmp_path),
            ),
        ):
            pass


def test_the_error_of_a_client_names_the_identity_that_was_not_taken(keys: SecurityFolder) -> None:
    endpoint = "tls/127.0.0.1:7447"

    assert "does not accept the identity ben" in str(router_refusal([endpoint], keys.identity("ben")))
    assert "requires --identity" in str(router_refusal([endpoint], None))
    assert "identity" not in str(router_refusal(["tcp/127.0.0.1:7447"], None))


def test_an_expired_identity_is_named_before_the_bus_is_tried(keys: SecurityFolder) -> None:
    identity = keys.identity("ben")

    with pytest.raises(ConfigError, match=r"identities/ben expired on .*security renew"):
        identity.check_valid(datetime(2100, 1, 1, tzinfo=UTC))
