"""STOP always reaches the board, and what was issued before it never does."""

from __future__ import annotations

import math
from typing import Any

import pytest

from gateway.access.authorize import Sender
from gateway.access.roles import Role
from gateway.board.limits import MAX_STOP
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.played_commands import CLOSED, START_NS, Rig, S


def test_stop_is_sent_each_time_it_is_asked_for_whatever_its_id() -> None:
    rig = Rig()
    first = rig.command(id="panel", stop=pb.Stop())
    assert rig.command(id="panel", set_mode=CLOSED).accepted

    again = rig.command(id="panel", stop=pb.Stop())
    mode = rig.command(id="mode", set_mode=CLOSED)
    other = rig.command(id="mode", stop=pb.Stop())

    assert (first.accepted, again.accepted, mode.accepted, other.accepted) == (True,) * 4
    assert rig.sent("STOP") == 3
    assert first.tick < again.tick < other.tick  # each its own
    assert [record.reply.tick for record in rig.records if record.command.WhichOneof("what") == "stop"] == [
        first.tick, again.tick, other.tick,
    ]  # fmt: skip


def dated(rig: Rig, age_s: float, **fields: Any) -> pb.CommandReply:
    """The reply to a command that was issued `age_s` ago."""
    return rig.command(issued_ns=rig.now_ns - round(age_s * S), valid_s=10.0, **fields)


@pytest.mark.parametrize("link", ["streaming", "absent"])
def test_what_was_issued_before_the_last_stop_is_never_sent(link: str) -> None:
    """Also where the STOP itself could not be sent, and however late the command comes."""
    rig = Rig()
    rig.now_s += 20.0
    rig.request(pb.Command(id="stop", stop=pb.Stop()).SerializeToString(), link=link)
    rig.now_s += 3.0

    before, after = dated(rig, 3.1, id="before", set_mode=CLOSED), dated(rig, 2.9, id="after", ping=pb.Ping())

    assert (before.accepted, before.refused_by, before.reason) == (False, "gateway", "superseded-by-stop")
    assert "0.100 s before the last STOP" in before.text
    assert after.accepted
    assert (rig.sent("SET_MODE"), rig.sent("PING")) == (0, 1)


def test_a_command_without_a_date_is_judged_by_its_arrival() -> None:
    """Its query may be overtaken by the STOP between the threads of the bus."""
    rig = Rig()
    sender = Sender(name="", role=None, arrived_ns=rig.now_ns - S, arrived_s=rig.now_s - 1.0, started_ns=START_NS)
    rig.command(id="stop", stop=pb.Stop())
    replies: list[pb.CommandReply] = []
    undated = pb.Command(id="late", set_mode=CLOSED).SerializeToString()

    rig.handler.take(undated, replies.append, rig.now_s, rig.now_ns, link="streaming", reason="", sender=sender)
    new = rig.command(id="new", set_mode=CLOSED)

    assert [reply.reason for reply in replies] == ["superseded-by-stop"]
    assert new.accepted


def test_a_new_date_does_not_make_a_command_newer_than_a_stop() -> None:
    """A sender that is refused by a gateway which has just started tries again with a new date."""
    rig = Rig()
    rig.now_s -= 99.9  # 0.1 s after the start of the gateway
    early = dated(rig, 0.0, id="again", set_mode=CLOSED)
    rig.now_s += 0.1
    rig.command(id="stop", stop=pb.Stop())
    rig.now_s += 1.4

    again, other = dated(rig, 0.0, id="again", set_mode=CLOSED), dated(rig, 0.0, id="other", ping=pb.Ping())

    assert (early.reason, again.reason) == ("not-fresh", "superseded-by-stop")
    assert other.accepted
    assert rig.sent("SET_MODE") == 0


@pytest.mark.parametrize("before_s", [-3600.0, 0.0, 3600.0])
@pytest.mark.parametrize("after_s", [-3600.0, 0.0, 3600.0])
def test_a_step_of_the_host_s_clock_before_or_after_a_stop_changes_nothing(before_s: float, after_s: float) -> None:
    rig = Rig()
    rig.now_s += 7200.0
    rig.command(id="earlier", stop=pb.Stop())
    rig.now_s += 10.0
    rig.stepped_s += before_s
    rig.command(id="stop", stop=pb.Stop())
    rig.stepped_s += after_s
    rig.now_s += 1.0

    assert dated(rig, 0.5, id="after", ping=pb.Ping()).accepted
    assert dated(rig, 1.5, id="before", ping=pb.Ping()).reason == "superseded-by-stop"


def test_a_remark_and_an_acknowledgement_outlive_a_stop() -> None:
    """They move nothing."""
    rig = Rig()
    rig.now_s += 20.0
    rig.command(id="stop", stop=pb.Stop())

    assert dated(rig, 0.5, id="remark", mark=pb.Mark(text="it hummed")).accepted


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"id": "x" * 1000},
        {"id": "1", "who": "y" * 1000},
        {"id": "1", "issued_ns": 1},
        {"id": "1", "issued_ns": 2**63},
        {"id": "1", "valid_s": math.nan},
        {"id": "x" * (MAX_STOP - 100)},
    ],
    ids=["bare", "long id", "long who", "old", "future", "not finite", "large"],
)
def test_no_form_keeps_a_stop_from_the_board(fields: dict[str, Any]) -> None:
    rig = Rig()

    (reply,) = rig.request(pb.Command(**fields, stop=pb.Stop()).SerializeToString(), role=Role.OPERATOR)

    assert reply.accepted, reply.text
    assert rig.sent("STOP") == 1


def test_neither_flood_nor_a_full_queue_keeps_a_stop_from_the_board() -> None:
    rig = Rig(commands_per_s=40.0)
    rig.answering = False
    refused = [rig.request(pb.Command(id=f"p{n}", ping=pb.Ping()).SerializeToString()) for n in range(60)]
    assert {r.reason for replies in refused for r in replies} == {"flood", "queue-full"}

    rig.answering = True
    (reply,) = rig.request(pb.Command(id="p0", stop=pb.Stop()).SerializeToString())

    assert reply.accepted


def test_a_stop_beside_a_stop_that_is_not_answered_has_its_own_answer() -> None:
    rig = Rig()
    rig.answering = False
    first = pb.Command(id="s", stop=pb.Stop()).SerializeToString()
    replies: list[pb.CommandReply] = []
    sender = Sender(name="", role=None, arrived_ns=rig.now_ns, arrived_s=rig.now_s, started_ns=START_NS)
    for _ in range(2):
        rig.handler.take(first, replies.append, rig.now_s, rig.now_ns, link="streaming", reason="", sender=sender)
    rig.answering = True
    rig.settle()

    assert len({reply.tick for reply in replies}) == 2
    assert len(rig.records) == 2


def test_every_stop_of_a_flood_is_answered_and_recorded() -> None:
    rig = Rig()
    replies: list[pb.CommandReply] = []
    sender = Sender(name="", role=None, arrived_ns=rig.now_ns, arrived_s=rig.now_s, started_ns=START_NS)
    for n in range(1000):
        payload = pb.Command(id=str(n), stop=pb.Stop()).SerializeToString()
        rig.handler.take(payload, replies.append, rig.now_s, rig.now_ns, link="streaming", reason="", sender=sender)
    rig.settle()

    assert len(replies) == len(rig.records) == 1000
    assert all(reply.accepted for reply in replies)


@pytest.mark.parametrize("link", ["handshake", "silent", "one-way"])
def test_stop_needs_a_port_and_nothing_else(link: str) -> None:
    rig = Rig()
    rig.known.scaling = None

    assert rig.request(pb.Command(stop=pb.Stop()).SerializeToString(), link=link)[0].accepted
    assert rig.request(pb.Command(stop=pb.Stop()).SerializeToString(), link="absent")[0].reason == "link-down"
