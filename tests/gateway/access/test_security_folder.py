"""The folder of `board51 security`: what is made, who is in it, what is refused; and the command around it."""

from __future__ import annotations

import json
import os
import shutil
import socket
import ssl
import stat
import subprocess
import sys
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from cryptography import x509

import board51
from gateway import daemon
from gateway.access.bus_rules import SERVICES
from gateway.access.certificates import DAYS, check_certificate
from gateway.access.folder import OPCUA_URI, SecurityFolder
from gateway.access.roles import Role
from gateway.access.users import User, Users
from gateway.config import GatewayConfig, LogConfig, SecurityConfig, ZenohConfig, load_config
from protocol.bus.identity import find_identity
from protocol.errors import ConfigError, UsageError
from tests.harness.gateway.access_peers import PASSWORD, PEOPLE
from tests.harness.gateway.gateway_peers import ScriptedBoard, gateway_config, running, wait_for
from tests.harness.ports import free_port


@pytest.fixture
def keys_copy(keys: SecurityFolder, tmp_path: Path) -> SecurityFolder:
    """A copy to spoil."""
    shutil.copytree(keys.path, tmp_path / "own")
    return SecurityFolder(tmp_path / "own")


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = board51.main(["security", *words])
    out, err = capsys.readouterr()
    return code, out, err


def test_everything_secret_is_its_owners_alone(keys: SecurityFolder) -> None:
    files = [path for path in keys.path.rglob("*") if path.is_file()]
    secret = [
        path for path in files if not path.name.endswith(("ca.pem", "certificate.pem", "server.pem", "router.pem"))
    ]

    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in secret if path.name != "security.toml"}

    assert len([path for path in modes if path.name.endswith("key.pem")]) == 1 + 3 + len(SERVICES) + len(PEOPLE)
    assert set(modes.values()) == {0o600}
    assert stat.S_IMODE(keys.path.stat().st_mode) == 0o700


def test_people_have_login_and_identity_with_the_same_role(keys: SecurityFolder) -> None:
    users = Users(keys.users)

    for name, role in PEOPLE.items():
        assert users.check(name, PASSWORD) == User(name=name, role=role)
        assert keys.identity(name).role == role.word
    assert keys.people() == PEOPLE


def test_the_password_of_the_bus_is_not_that_of_the_login(keys: SecurityFolder) -> None:
    assert PASSWORD not in keys.passwords.read_text()
    assert len({keys.identity(name).password for name in (*SERVICES, *PEOPLE)}) == len(SERVICES) + len(PEOPLE)


def test_certificates_are_good_for_what_they_are_used_for(keys: SecurityFolder) -> None:
    def names(path: Path) -> tuple[list[str], list[str]]:
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
        alternative = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = alternative.get_values_for_type(x509.UniformResourceIdentifier)
        return alternative.get_values_for_type(x509.DNSName), uris

    assert names(keys.server("bus")[0]) == (["localhost"], [])
    assert names(keys.server("opcua")[0]) == (["localhost"], [OPCUA_URI])
    assert names(keys.identity("ben").folder / "certificate.pem") == ([], ["urn:board51:user:ben"])


def test_a_browser_that_trusts_the_authority_takes_the_pages_certificate(keys: SecurityFolder) -> None:
    server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    server.load_cert_chain(*keys.server("hmi"))
    client = ssl.create_default_context(cafile=keys.ca)
    client_end, server_end = socket.socketpair()
    thread = threading.Thread(target=lambda: server.wrap_socket(server_end, server_side=True).close())
    thread.start()

    with client.wrap_socket(client_end, server_hostname="127.0.0.1") as line:
        assert line.version() == "TLSv1.3"
    thread.join()


def test_renewing_keeps_passwords_and_people(keys_copy: SecurityFolder) -> None:
    before = {name: keys_copy.identity(name) for name in (*SERVICES, *PEOPLE)}
    later = datetime.now(UTC) + timedelta(days=400)

    keys_copy.renew(now=later)

    for name, old in before.items():
        new = keys_copy.identity(name)
        assert (new.password, new.role) == (old.password, old.role)
        assert new.valid_until - old.valid_until > timedelta(days=399)
    assert min(keys_copy.check(now=later).values()) == pytest.approx(DAYS, abs=0.1)


def test_who_is_removed_is_nowhere_left(keys_copy: SecurityFolder) -> None:
    keys_copy.remove_user("ben")

    assert "ben" not in keys_copy.people()
    assert "ben" not in keys_copy.passwords.read_text()
    assert "ben" not in keys_copy.router_config.read_text()
    assert not keys_copy.identity_path("ben").exists()
    with pytest.raises(UsageError, match=r"ben is not a user.*ana"):
        keys_copy.remove_user("ben")


def test_a_new_role_reaches_the_rules_of_the_router(keys_copy: SecurityFolder) -> None:
    keys_copy.add_user(User(name="ben", role=Role.ENGINEER), PASSWORD)

    rules = {rule["id"]: rule for rule in json.loads(keys_copy.router_config.read_text())["access_control"]["rules"]}
    assert rules["ben-commands"]["key_exprs"] == [
        "board51/*/command/as/engineer/ben",
        "board51/*/twin/command/as/engineer/ben",
    ]
    keys_copy.check()


@pytest.mark.parametrize("name", SERVICES)
def test_the_names_of_services_are_nobodys(keys_copy: SecurityFolder, name: str) -> None:
    with pytest.raises(UsageError, match="name of a service"):
        keys_copy.add_user(User(name=name, role=Role.ENGINEER), PASSWORD)


def test_an_old_folder_is_not_overwritten(keys: SecurityFolder) -> None:
    with pytest.raises(UsageError, match=r"is not empty.*security renew"):
        keys.init()


@pytest.mark.parametrize(
    "name", ["users.toml", "bus/passwords.txt", "bus/router-key.pem", "opcua/server-key.pem", "identities/ben/key.pem",
             "identities/ben/identity.toml", "ca-key.pem"]
)  # fmt: skip
def test_a_secret_open_to_others_is_found(keys_copy: SecurityFolder, name: str) -> None:
    (keys_copy.path / name).chmod(0o640)

    with pytest.raises(ConfigError, match=r"open to others \(mode 0640\).*chmod 600"):
        keys_copy.check()


@pytest.mark.parametrize("name", ["ca.pem", "bus/router.pem", "identities/ana/certificate.pem"])
def test_a_certificate_that_is_none_is_found(keys_copy: SecurityFolder, name: str) -> None:
    (keys_copy.path / name).write_text("nonsense")
    with pytest.raises(ConfigError, match=r"not a certificate in PEM"):
        keys_copy.check()
    (keys_copy.path / name).unlink()
    with pytest.raises(ConfigError, match=r"cannot be read: No such file"):
        keys_copy.check()


def test_an_expired_certificate_is_named_with_its_day(keys: SecurityFolder) -> None:
    certificate, _ = keys.server("opcua")
    then = datetime.now(UTC) + timedelta(days=DAYS + 1)

    with pytest.raises(ConfigError, match=r"server.pem expired on 20\d\d-\d\d-\d\d.*security renew"):
        check_certificate(certificate, what="The certificate", now=then)
    with pytest.raises(ConfigError, match=r"not valid before .*clock"):
        check_certificate(certificate, what="The certificate", now=datetime(2001, 1, 1, tzinfo=UTC))


def test_a_role_that_differs_between_login_and_bus_is_found(keys_copy: SecurityFolder) -> None:
    text = keys_copy.users.read_text()
    keys_copy.users.write_text(text.replace('role = "operator"', 'role = "engineer"'))

    with pytest.raises(ConfigError, match=r"ben is engineer in users.toml and operator on the bus.*renew"):
        keys_copy.check()


# -- the gateway that uses it


def guarded(keys_copy: SecurityFolder, listen: str) -> GatewayConfig:
    config = gateway_config("/dev/null")
    return replace(config, zenoh=ZenohConfig(listen=(listen,)), security=SecurityConfig(directory=str(keys_copy.path)))


def test_a_gateway_does_not_start_with_an_expired_certificate(keys_copy: SecurityFolder) -> None:
    keys_copy.renew(days=-1)

    with pytest.raises(ConfigError, match=r"expired on .*security renew"):
        daemon.run(guarded(keys_copy, f"tls/127.0.0.1:{free_port()}"), threading.Event())


def test_a_gateway_says_that_certificates_must_be_renewed(keys_copy: SecurityFolder, tmp_path: Path) -> None:
    keys_copy.renew(days=7.2)

    with ScriptedBoard() as board:
        config = guarded(keys_copy, f"tls/127.0.0.1:{free_port()}")
        config = replace(config, boards=(replace(config.boards[0], port=board.url),))
        logs = tmp_path / "logs"
        config = replace(config, log=LogConfig(directory=str(logs), min_free_bytes=0, compression="none"))

        def is_reported() -> bool:
            return any(
                b"certificate of bus/router expires in 7 days" in log.read_bytes() for log in logs.glob("*.mcap")
            )

        with running(config):
            wait_for(is_reported, "event in the log", 60.0)

    (keys_copy.path / "bus" / "router.pem").write_text("")
    assert "not a certificate" in daemon.expiring(config)[0]


def test_a_gateway_does_not_start_with_a_key_open_to_others(keys_copy: SecurityFolder) -> None:
    (keys_copy.path / "bus" / "router-key.pem").chmod(0o644)

    with pytest.raises(ConfigError, match=r"open to others"):
        daemon.run(guarded(keys_copy, f"tls/127.0.0.1:{free_port()}"), threading.Event())


def test_a_gateway_of_another_site_does_not_start(keys_copy: SecurityFolder) -> None:
    with pytest.raises(ConfigError, match=r"guards the site board51, the gateway serves lab"):
        daemon.check(replace(guarded(keys_copy, "tls/127.0.0.1:1"), site="lab"))


def test_a_gateway_without_keys_does_not_listen_with_tls() -> None:
    config = replace(gateway_config("/dev/null"), zenoh=ZenohConfig(listen=("tls/127.0.0.1:7447",)))

    with pytest.raises(ConfigError, match=r"tls/127.0.0.1:7447 has no keys.*--security DIR"):
        daemon.check(config)


def test_a_gateway_without_security_is_not_open_to_the_network() -> None:
    config = replace(gateway_config("/dev/null"), zenoh=ZenohConfig(listen=("tcp/0.0.0.0:7447",)))

    with pytest.raises(ConfigError, match=r"without protection.*--insecure"):
        daemon.check(config)
    daemon.check(replace(config, security=SecurityConfig(insecure=True)))


def test_the_section_is_read_from_file_and_environment(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('[security]\ndirectory = "keys"\n')

    assert load_config(file, {}).security == SecurityConfig(directory="keys")
    assert load_config(None, {"BOARD51_SECURITY_INSECURE": "true"}).security == SecurityConfig(insecure=True)


# -- identities


def test_the_identity_comes_from_flag_then_environment(keys: SecurityFolder) -> None:
    ana, ben = (str(keys.identity_path(name)) for name in ("ana", "ben"))

    flag, variable, none = (
        find_identity(ana, {"BOARD51_IDENTITY": ben}),
        find_identity(None, {"BOARD51_IDENTITY": ben}),
        find_identity(None, {}),
    )

    assert flag is not None
    assert variable is not None
    assert (flag.name, variable.name, none) == ("ana", "ben", None)
    assert flag.password not in repr(flag)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"No such file"),
        ("name = ", r"not TOML"),
        ('name = "ana"\nrole = "viewer"', r"has no password"),
        ('name = "ana"\nrole = "viewer"\npassword = "x"\nvalid_until = 3', r"has no valid_until"),
    ],
)
def test_a_folder_that_is_no_identity_is_named(keys_copy: SecurityFolder, text: str | None, message: str) -> None:
    file = keys_copy.identity_path("ana") / "identity.toml"
    file.unlink()
    if text is not None:
        file.write_text(text)
        file.chmod(0o600)

    with pytest.raises(ConfigError, match=message):
        keys_copy.identity("ana")


# -- the command


def test_init_makes_people_and_prints_each_password_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "keys"

    code, out, _ = run(capsys, "init", str(folder), "--host", "10.0.0.5", "--user", "eva:operator")

    assert code == 0
    (line,) = [line for line in out.splitlines() if line.startswith("eva")]
    assert Users(folder / "users.toml").check("eva", line.split()[-1]) == User(name="eva", role=Role.OPERATOR)
    addresses = x509.load_pem_x509_certificate((folder / "bus/router.pem").read_bytes()).extensions
    names = addresses.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "10.0.0.5" in [str(address) for address in names.get_values_for_type(x509.IPAddress)]
    assert run(capsys, "add-user", str(folder), "eva:viewer")[0] == 0
    assert run(capsys, "remove-user", str(folder), "eva")[0] == 0
    assert json.loads(run(capsys, "check", str(folder), "--json")[1])["users"] == {}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["init", "{new}", "--user", "ana"], "does not name a role"),
        (["init", "{new}", "--user", "ana:boss"], "'boss' is not a role. Write one of viewer, operator, engineer"),
        (["init", "{new}", "--user", "A B:viewer"], "is not a name"),
        (["init", "{old}"], "is not empty"),
        (["add-user", "{old}", "gateway:viewer"], "name of a service"),
        (["add-user", "{new}", "ana:viewer"], "security init"),
        (["remove-user", "{old}", "eve"], "eve is not a user"),
        (["check", "{new}"], "security init"),
        (["renew", "{new}"], "security init"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_two(
    keys: SecurityFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    filled = [word.format(new=tmp_path / "new", old=keys.path) for word in words]

    code, _, err = run(capsys, *filled)

    assert code == 2
    assert len(err.splitlines()) == 1
    assert message in err
    assert os.listdir(tmp_path) == []  # nothing half made is left behind


def test_the_configuration_for_other_languages_is_its_owner_s_alone(keys: SecurityFolder, tmp_path: Path) -> None:
    identity, file, printed = keys.identity_path("ben"), tmp_path / "ben.json5", tmp_path / "printed.json5"
    words = [sys.executable, "-m", "board51", "security", "zenoh-config", str(identity)]

    written = subprocess.run([*words, "--out", str(file)], capture_output=True, text=True, check=False)
    with printed.open("wb") as out:
        printed.chmod(0o644)
        refused = subprocess.run(words, stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    with printed.open("wb") as out:
        printed.chmod(0o600)
        private = subprocess.run(words, stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    piped = subprocess.run(words, capture_output=True, text=True, check=False)

    assert (written.returncode, written.stderr, written.stdout) == (0, "", "")
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
    assert "--out FILE" in refused.stderr
    assert (private.returncode, piped.returncode) == (0, 0)
    assert file.read_text() == printed.read_text() == piped.stdout
    assert zenoh.Config.from_json5(piped.stdout).get_json("transport/auth/usrpwd/user") == '"ben"'


def test_a_password_printed_into_an_open_file_is_said(keys_copy: SecurityFolder, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "board51", "security", "add-user", str(keys_copy.path), "eva:viewer"]

    with (tmp_path / "out").open("wb") as out:
        (tmp_path / "out").chmod(0o644)
        process = subprocess.run(words, stdout=out, stderr=subprocess.PIPE, text=True, check=False)

    assert process.returncode == 0
    assert "others may read the password of eva" in process.stderr
