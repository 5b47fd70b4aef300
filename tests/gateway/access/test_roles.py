"""The table of rights."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.access.roles import MINIMUM_ROLE, Role, may, parse_role, refusal_text
from protocol.bus import board51_pb2 as pb
from protocol.errors import ConfigError


def test_every_kind_of_command_has_a_least_role() -> None:
    kinds = [
        field.name
        for message in (pb.Command, pb.TwinCommand)
        for field in message.DESCRIPTOR.oneofs_by_name["what"].fields
    ]

    assert [kind for kind in kinds if kind not in MINIMUM_ROLE] == []


@pytest.mark.parametrize("act", ["set_mode", "set_reference", "excite", "capture"])
def test_an_operator_moves_the_ball_and_a_viewer_does_not(act: str) -> None:
    assert may(Role.OPERATOR, act)
    assert may(Role.ENGINEER, act)
    assert not may(Role.VIEWER, act)


def test_everybody_who_is_let_in_may_stop_and_a_viewer_sends_nothing_else() -> None:
    commands = {field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields}

    assert {act for act in commands if may(Role.VIEWER, act)} == {"stop", "ping"}


@pytest.mark.parametrize("act", ["set_gains", "set_stream", "set_host_loss", "use_model"])
def test_only_an_engineer_changes_the_rig(act: str) -> None:
    assert [role for role in Role if may(role, act)] == [Role.ENGINEER]


def test_an_unknown_act_is_nobodys_right() -> None:
    assert not any(may(role, "fly") for role in Role)
    assert "nobody may" in refusal_text("ana", Role.ENGINEER, "fly")


def test_a_refusal_says_which_role_it_needs() -> None:
    assert (
        refusal_text("ana", Role.OPERATOR, "set_gains")
        == "ana (operator) may not set gains: it needs the role engineer."
    )


def test_a_typo_in_a_role_names_place_and_allowed_words() -> None:
    with pytest.raises(ConfigError, match=r"users.toml line 2: 'operater' is not a role.*viewer, operator, engineer"):
        parse_role("operater", where="users.toml line 2")


def test_the_table_on_the_page_is_that_of_the_code() -> None:
    page = (Path(__file__).parents[3] / "gateway" / "README.md").read_text(encoding="utf-8")

    for role in Role:
        acts = ", ".join(act for act, minimum in MINIMUM_ROLE.items() if minimum is role)
        assert f"\n| {role.word} | {acts} |\n" in page
