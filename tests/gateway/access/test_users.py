"""Users: passwords, the file and its mistakes."""

from __future__ import annotations

import stat
import time
from pathlib import Path

import pytest

from gateway.access.passwords import hash_password, is_line, matches
from gateway.access.roles import Role
from gateway.access.users import User, Users, remove_user, set_user
from protocol.errors import ConfigError, UsageError

ANA = User(name="ana", role=Role.OPERATOR)
# Of "correct horse"; written out, because the ids of tests hold it and are the same in each process of a run.
LINE = (
    "scrypt$16384$8$1$5c4e47a1a18edc655edc4762425daebe$86557bfff6c8780bc17256fc581a0625ae9dca80b0e400a16f10f5451003f586"
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "users.toml"
    set_user(file, ANA, "correct horse")
    return file


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    path.chmod(0o600)
    return path


def test_the_right_password_gives_name_and_role(path: Path) -> None:
    users = Users(path)

    assert users.check("ana", "correct horse") == ANA
    assert users.check("ana", "battery staple") is None
    assert users.check("eve", "correct horse") is None
    assert users.check("ana", "") is None


def test_the_file_is_private_and_holds_no_password(path: Path) -> None:
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert "correct horse" not in path.read_text()


def test_equal_passwords_have_unequal_lines() -> None:
    lines = {LINE, *(hash_password("correct horse") for _ in range(2))}

    assert len(lines) == 3
    assert all(matches("correct horse", line) for line in lines)


def test_a_wrong_name_costs_the_time_of_a_wrong_password(path: Path) -> None:
    users = Users(path)

    def cpu_s(name: str) -> float:
        start_s = time.thread_time()
        assert users.check(name, "wrong password") is None
        return time.thread_time() - start_s

    known, unknown = min(cpu_s("ana") for _ in range(3)), min(cpu_s("eve") for _ in range(3))

    assert unknown > 0.5 * known


def test_a_change_of_the_file_is_taken_over(path: Path) -> None:
    users = Users(path)

    set_user(path, User(name="ana", role=Role.ENGINEER), "correct horse")
    assert users.find("ana") == User(name="ana", role=Role.ENGINEER)
    assert remove_user(path, "ana")
    assert users.find("ana") is None
    assert users.check("ana", "correct horse") is None


def test_a_change_that_breaks_the_file_leaves_the_users_as_they_were(path: Path) -> None:
    users = Users(path)

    write(path, "[users.ana")

    assert users.find("ana") == ANA


def test_a_file_open_to_others_is_refused(path: Path) -> None:
    path.chmod(0o644)

    with pytest.raises(ConfigError, match=r"open to others \(mode 0644\).*chmod 600"):
        Users(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            f'[users.ana]\nrole = "operater"\npassword = "{LINE}"',
            r"users.toml: user ana: 'operater' is not a role.*viewer, op",
        ),
        (f'# x\n\n[users.ana]\npassword = "{LINE}"\nrole = "admin"', r"user ana: 'admin' is not a role"),
        (f'[users.ana]\npassword = "{LINE}"', r"users.ana.role is missing .*role = viewer \| op"),
        ('[users.ana]\nrole = "viewer"\npassword = "secret"', "user ana has no usable password"),
        ('[users.ana]\nrole = "viewer"', "users.ana.password is missing .*security add-user"),
        (f'[users.ana]\nrole = "viewer"\npasswort = "{LINE}"', "users.ana.password is missing"),
        (f'[user.ana]\nrole = "viewer"\npassword = "{LINE}"', "user = ... is not a key"),
        (f'[users.ana]\nrole = "viewer"\npassword = "{LINE}"\nhash = "{LINE}"', "users.ana.hash = ... is not a key"),
        ('[users."a b"]\nrole = "viewer"\npassword = "x"', "user 'a b' is not a name"),
        ("users = 3", "users = ... is not a table"),
        ("[users]\nana = 3", "users.ana = ... is not a table"),
        ("[users.ana", "not TOML"),
    ],
)
def test_a_mistake_in_the_file_is_named_with_its_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        Users(write(tmp_path / "users.toml", text))

    assert "scrypt" not in str(error.value)


def test_an_absent_file_says_what_makes_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"No such file.*security init"):
        Users(tmp_path / "users.toml")


@pytest.mark.parametrize("password", ["short", "x" * 257])
def test_a_password_has_a_sensible_length(password: str) -> None:
    with pytest.raises(UsageError, match="characters"):
        hash_password(password)


@pytest.mark.parametrize(
    "line", ["", "plain", LINE.replace("16384", "1073741824"), LINE.replace("16384", "3"), LINE[:-2], LINE + "$"]
)
def test_a_damaged_password_line_is_known_as_such(line: str) -> None:
    assert is_line(LINE)
    assert not is_line(line)
