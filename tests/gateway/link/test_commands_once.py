"""A command is executed once and in time, or never: ids, ages, the patience of its sender."""

from __future__ import annotations

import pytest

from gateway.access.authorize import MAX_AGE_S, Sender
from gateway.access.roles import Role
from gateway.link.command_handler import RETAINED_IDS, RETAINED_S
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.played_commands import CLOSED, START_NS, Rig, S


@pytest.mark.parametrize("other_count", [0, RETAINED_IDS + 10])
def test_a_dated_command_is_executed_once_however_late_it_comes_again(other_count: int) -> None:
    rig = Rig()
    command = pb.Command(id="a", issued_ns=rig.now_ns, set_mode=CLOSED)
    (first,) = rig.request(command.SerializeToString())
    reasons = []
    for k in range(12):
        rig.wait(2.5)
        for n in range(other_count):
            assert rig.command(id=f"p{k}-{n}", ping=pb.Ping()).accepted
        (again,) = rig.request(command.SerializeToString())
        reasons.append(again.reason)
        assert again == first or again.reason == "not-fresh"

    assert first.accepted
    assert rig.sent("SET_MODE") == 1
    assert reasons[0] == ""
    assert reasons[-1] == ("not-fresh" if other_count else "")


def test_an_undated_command_is_executed_once_until_the_reply_says() -> None:
    rig = Rig()
    command = pb.Command(id="a", set_mode=CLOSED).SerializeToString()
    (first,) = rig.request(command)
    assert first.repeat_until_ns == rig.now_ns + round(RETAINED_S * S)
    for n in range(RETAINED_IDS):
        rig.command(id=f"p{n}", ping=pb.Ping())

    rig.wait(RETAINED_S - 0.1)
    assert rig.request(command) == [first]
    rig.wait(0.2)
    for n in range(RETAINED_IDS):
        rig.command(id=f"q{n}", ping=pb.Ping())
    (repeated,) = rig.request(command)

    assert repeated.tick > first.tick  # executed again: that is what the reply said, and why a command should be dated
    assert rig.sent("SET_MODE") == 2


@pytest.mark.parametrize("role", [None, Role.OPERATOR])
def test_a_dated_command_expires_on_every_bus(role: Role | None) -> None:
    rig = Rig()
    rig.wait(30.0)
    old, brief, new = (
        pb.Command(id=str(n), issued_ns=rig.now_ns - round(age_s * S), valid_s=valid_s, set_mode=CLOSED)
        for n, (age_s, valid_s) in enumerate([(MAX_AGE_S + 0.1, 60.0), (3.0, 2.0), (3.0, 0.0)])
    )

    replies = [rig.request(command.SerializeToString(), role=role)[0] for command in (old, brief, new)]

    assert [reply.reason for reply in replies] == ["not-fresh", "not-fresh", ""]
    assert replies[0].repeat_until_ns == 0


# -- nothing acts later


def test_a_reply_says_whether_a_byte_went_out_and_what_never_did_may_be_tried_again() -> None:
    rig = Rig()
    rig.answering = False
    sent = pb.Command(id="a", set_mode=CLOSED).SerializeToString()
    assert rig.request(sent) == []
    rig.wait(1.0)
    held: list[pb.CommandReply] = []
    sender = Sender(name="", role=None, arrived_ns=rig.now_ns, arrived_s=rig.now_s, started_ns=START_NS)
    later = pb.Command(id="b", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)).SerializeToString()
    rig.handler.take(later, held.append, rig.now_s, rig.now_ns, link="streaming", reason="", sender=sender)
    rig.wait(3.0)

    first, second = rig.records
    assert (first.reply.reason, first.reply.attempts > 0) == ("timed-out", True)
    assert "unknown" in first.reply.text
    assert [(r.reason, r.attempts, r.repeat_until_ns) for r in held] == [("timed-out", 0, 0)]
    assert "never will" in second.reply.text
    assert [m.int("mode") for m in rig.wire if m.name == "SET_MODE"] == [2] * 5

    rig.answering = True
    assert rig.request(later)[0].accepted  # nothing was executed: the same id is good


def test_a_command_does_not_outlive_the_patience_of_its_sender() -> None:
    rig = Rig()
    rig.answering = False
    rig.wait(1.0)
    replies: list[pb.CommandReply] = []
    sender = Sender(name="", role=None, arrived_ns=rig.now_ns, arrived_s=rig.now_s, started_ns=START_NS)
    command = pb.Command(id="a", issued_ns=rig.now_ns, valid_s=0.3, set_mode=CLOSED).SerializeToString()
    rig.handler.take(command, replies.append, rig.now_s, rig.now_ns, link="streaming", reason="", sender=sender)

    rig.wait(0.31)
    rig.answering = True
    rig.wait(1.0)

    assert [reply.reason for reply in replies] == ["timed-out"]
    assert rig.sent("SET_MODE") == 0
