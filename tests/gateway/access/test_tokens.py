"""Tokens of programs: only their digests are kept, they have at most the role of their user, and end with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.access.roles import Role
from gateway.access.tokens import digest_of, new_token
from gateway.access.users import User, Users, remove_token, remove_user, set_token, set_user
from gateway.commands import security
from protocol.errors import ConfigError, UsageError
from tests.harness.gateway.access_peers import made_folder

ANA = User(name="ana", role=Role.ENGINEER)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "users.toml"
    set_user(file, ANA, "correct horse")
    return file


def acts_for(path: Path, token: str) -> User | None:
    return Users(path).bearer(digest_of(token))


def test_a_token_acts_for_its_user_and_the_file_has_its_digest_alone(path: Path) -> None:
    token = set_token(path, "matlab", ANA)

    assert acts_for(path, token) == ANA
    assert acts_for(path, new_token()) is None
    assert token not in path.read_text()


def test_a_token_has_the_lower_role_of_itself_and_its_user(path: Path) -> None:
    low = set_token(path, "grafana", User(name="ana", role=Role.VIEWER))
    high = set_token(path, "matlab", ANA)
    assert acts_for(path, low) == User(name="ana", role=Role.VIEWER)

    set_user(path, User(name="ana", role=Role.OPERATOR), "correct horse")

    assert acts_for(path, high) == User(name="ana", role=Role.OPERATOR)
    assert acts_for(path, low) == User(name="ana", role=Role.VIEWER)
    with pytest.raises(UsageError, match=r"ana is operator, so a token cannot be engineer\. Give --role operator"):
        set_token(path, "matlab", ANA)


def test_a_token_ends_when_it_or_its_user_is_removed_or_it_is_made_anew(path: Path) -> None:
    users = Users(path)
    first, other = set_token(path, "matlab", ANA), set_token(path, "octave", ANA)

    second = set_token(path, "matlab", ANA)
    assert [users.bearer(digest_of(token)) for token in (first, second, other)] == [None, ANA, ANA]
    remove_token(path, "octave")
    assert users.bearer(digest_of(other)) is None
    remove_user(path, "ana")

    assert users.bearer(digest_of(second)) is None
    assert "tokens" not in path.read_text().replace("token` ", "")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('user = "ana"\nrole = "boss"\nsha256 = "{digest}"', "'boss' is not a role"),
        ('user = "ana"\nrole = "viewer"\nsha256 = "short"', "token matlab has no SHA-256"),
        ('user = "a/b"\nrole = "viewer"\nsha256 = "{digest}"', "user"),
        ('user = "ana"\nrole = "viewer"', "sha256 is missing"),
    ],
)
def test_a_mistake_in_the_file_is_named_without_the_digest(path: Path, table: str, message: str) -> None:
    digest = digest_of("x")
    path.write_text(path.read_text() + "[tokens.matlab]\n" + table.format(digest=digest) + "\n")

    with pytest.raises(ConfigError, match=message) as refused:
        Users(path)

    assert digest not in str(refused.value)


def test_the_command_prints_a_token_once_and_removes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import argparse

    folder = made_folder(tmp_path / "keys")
    parser = argparse.ArgumentParser()
    security.configure(parser)

    def run(*words: str) -> str:
        assert security.run(parser.parse_args([*words[:1], str(folder.path), *words[1:]])) == 0
        return capsys.readouterr().out.strip()

    token = run("add-token", "matlab", "--user", "ben")
    look = run("add-token", "grafana", "--user", "ben", "--role", "viewer")

    assert acts_for(folder.users, token) == User(name="ben", role=Role.OPERATOR)
    assert acts_for(folder.users, look) == User(name="ben", role=Role.VIEWER)
    run("remove-token", "matlab")
    assert acts_for(folder.users, token) is None
    with pytest.raises(UsageError, match=r"matlab is not a token\. There are grafana"):
        run("remove-token", "matlab")
    with pytest.raises(UsageError, match="eve is not a user"):
        run("add-token", "x", "--user", "eve")
