"""Freshness, memory of ids and shares of senders, on times that the test makes."""

from __future__ import annotations

import sys
import time
from types import FrameType
from typing import Any

import pytest

from gateway.access.authorize import BURST, COMMANDS_PER_S, MAX_AGE_S, MAX_AHEAD_S, MAX_SENDERS, Authorizer, Sender
from gateway.access.roles import Role
from gateway.board.limits import Gate
from gateway.board.scaling import Refusal
from gateway.config import BoardConfig, LimitsConfig
from gateway.link.clock import HostClock
from gateway.link.command_handler import RETAINED_IDS, RETAINED_S
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import Collector, ScriptedBoard, wait_for

S = 1_000_000_000
START_NS = 1_700_000_000 * S


def sender(role: Role = Role.OPERATOR, *, after_s: float = 100.0, name: str = "ben") -> Sender:
    return Sender(
        name=name, role=role, arrived_ns=START_NS + round(after_s * S), arrived_s=after_s, started_ns=START_NS
    )


def issued(after_s: float, **what: object) -> pb.Command:
    what = what or {"ping": pb.Ping()}
    return pb.Command(id="1", issued_ns=START_NS + round(after_s * S), **what)  # type: ignore[arg-type]  # any of its fields


@pytest.mark.parametrize("age_s", [0.0, MAX_AGE_S, -MAX_AHEAD_S])
def test_a_command_of_now_is_fresh(age_s: float) -> None:
    assert sender().fresh(issued(100.0 - age_s)) is None


@pytest.mark.parametrize("age_s", [MAX_AGE_S + 0.01, -MAX_AHEAD_S - 0.01, 99.5])
def test_a_command_of_another_time_is_not(age_s: float) -> None:
    refusal = sender().fresh(issued(100.0 - age_s))

    assert refusal is not None
    assert refusal.reason == "not-fresh"


def test_what_the_gateway_before_may_have_executed_is_refused() -> None:
    """Its clock and the sender's may differ by MAX_AHEAD_S: a command just before the restart may bear a later time."""
    early = sender(after_s=MAX_AHEAD_S)

    assert early.fresh(issued(MAX_AHEAD_S - 0.01)) is not None
    assert early.fresh(issued(MAX_AHEAD_S)) is None
    assert early.fresh(issued(MAX_AHEAD_S - 0.01, stop=pb.Stop())) is None


def test_a_clock_set_back_does_not_shut_everybody_out() -> None:
    authorizer = Authorizer(START_NS, lambda *_: None)
    now_ns = START_NS - 3600 * S  # as a host without a battery finds after its first contact with a time server
    command = pb.Command(id="1", issued_ns=now_ns, ping=pb.Ping())

    before = authorizer.sender("board51/rig/command/as/operator/ben", now_ns, 0.0)
    assert isinstance(before, Sender)
    assert before.fresh(command) is not None

    authorizer.clock_stepped(-3700 * S)
    after = authorizer.sender("board51/rig/command/as/operator/ben", now_ns, 0.0)
    assert isinstance(after, Sender)
    assert after.fresh(command) is None


def test_a_clock_set_forward_does_not_let_in_what_is_older_than_the_gateway() -> None:
    """A host that boots without a clock finds the time after its gateway has started."""
    authorizer, step_s = Authorizer(START_NS, lambda *_: None), 3600
    authorizer.clock_stepped(step_s * S)
    now_ns = START_NS + (step_s + 5) * S  # 5 s after the start
    command_sender = authorizer.sender("board51/rig/command/as/operator/ben", now_ns, 0.0)

    assert isinstance(command_sender, Sender)
    assert command_sender.fresh(pb.Command(id="1", issued_ns=now_ns - 6 * S, ping=pb.Ping())) is not None
    assert command_sender.fresh(pb.Command(id="1", issued_ns=now_ns - 3 * S, ping=pb.Ping())) is None


@pytest.mark.parametrize(("issued_ns", "fresh"), [(0, True), (1, False), (START_NS + 99 * S, True)])
def test_on_a_bus_that_is_not_guarded_a_command_may_be_undated_and_nobody_has_a_role(
    issued_ns: int, fresh: bool
) -> None:
    authorizer = Authorizer(START_NS, lambda *_: None, guarded=False)
    command_sender = authorizer.sender("board51/rig/command", START_NS + 100 * S, 0.0)
    command = pb.Command(id="1", who="eve", role="engineer", issued_ns=issued_ns, set_gains=pb.SetGains())

    assert isinstance(command_sender, Sender)
    command_sender.sign(command)

    assert (command.who, command.role, command_sender.right(command)) == ("eve", "", None)
    assert (command_sender.fresh(command) is None) == fresh


def test_ids_are_remembered_for_longer_than_a_command_is_fresh() -> None:
    assert RETAINED_S > MAX_AGE_S + MAX_AHEAD_S


def test_many_commands_do_not_make_the_desk_forget_one_that_is_still_fresh() -> None:
    """At 50 commands per second 256 ids are 5 s, and a command is fresh for 10 s."""
    replies: list[pb.CommandReply] = []
    with ScriptedBoard() as board:
        driver = BoardDriver(
            BoardConfig(name="rig", port=board.url, command_timeout_s=10.0, limits=LimitsConfig(commands_per_s=1000.0)),
            Collector(),
            HostClock(),
        )
        link = LinkThread([driver])
        link.start()
        try:
            wait_for(lambda: driver.link == "streaming", "stream")
            for n in (*range(RETAINED_IDS + 50), 0):
                now_ns = time.time_ns()
                ben = Sender(name="ben", role=Role.OPERATOR, arrived_ns=now_ns, arrived_s=0.0, started_ns=START_NS)
                command = pb.Command(id=str(n), issued_ns=now_ns, set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP))
                count = len(replies)
                link.command(driver, command.SerializeToString(), replies.append, ben)
                wait_for(lambda count=count: len(replies) > count, "reply")  # type: ignore[misc]  # no type for a lambda default
        finally:
            link.stop()

    assert all(reply.accepted for reply in replies)
    assert replies[-1] == replies[0]
    assert board.names().count("SET_MODE") == RETAINED_IDS + 50


def test_one_sender_has_a_share_and_gets_it_back() -> None:
    reports: list[tuple[str, int]] = []
    authorizer = Authorizer(START_NS, lambda who, count: reports.append((who, count)))
    ben, ana = sender(), sender(name="ana")

    refused = [authorizer.flooded(ben, 0.0) for _ in range(round(BURST) + 50)]

    assert refused.count(False) == BURST
    assert not authorizer.flooded(ana, 0.0)
    assert authorizer.flooded(ben, 0.0)
    assert not authorizer.flooded(ben, 1.0 / COMMANDS_PER_S + 1e-6)
    assert reports == [("ben", 1)]  # once a second, not once a command
    authorizer.flooded(ben, 1.0)
    for _ in range(round(BURST) + 50):
        authorizer.flooded(ben, 1.5)
    assert [who for who, _ in reports] == ["ben", "ben"]
    assert reports[1][1] > 50


def test_invented_names_do_not_fill_the_memory() -> None:
    authorizer = Authorizer(START_NS, lambda *_: None)

    for n in range(3 * MAX_SENDERS):
        authorizer.flooded(sender(name=f"eve{n}"), 0.0)

    assert len(authorizer._floods) == MAX_SENDERS


@pytest.mark.parametrize(
    "key",
    ["board51/rig/command", "board51/rig/command/as/**", "board51/rig/command/as/boss/ben",
     "board51/rig/command/as/operator", "board51/rig/command/as/operator/b/n", "board51/rig/command/as/operator/*",
     "board51/rig/command/as/OPERATOR/ben"],
)  # fmt: skip
def test_a_key_that_does_not_say_who_and_role_is_nobodys(key: str) -> None:
    refusal = Authorizer(START_NS, lambda *_: None).sender(key, START_NS, 0.0)

    assert isinstance(refusal, Refusal)
    assert refusal.reason == "not-allowed"


def test_the_work_for_a_command_does_not_grow_with_the_number_of_senders() -> None:
    """A flood is judged in zenoh's threads: a slow judgement would hold up all others."""
    authorizer = Authorizer(START_NS, lambda *_: None)

    def steps() -> int:
        """Count the lines that one command of one sender runs through, those of a loop each time."""
        counted = 0

        def count(_frame: FrameType, _event: str, _arg: object) -> Any:
            nonlocal counted
            counted += 1
            return count

        before = sys.gettrace()
        sys.settrace(count)
        try:
            ben = authorizer.sender("board51/rig/command/as/operator/ben", START_NS, 0.0)
            assert isinstance(ben, Sender)
            authorizer.flooded(ben, 0.0)
        finally:
            sys.settrace(before)
        return counted

    steps()  # ben is known from here on
    single = steps()
    for n in range(MAX_SENDERS - 1):
        authorizer.flooded(sender(name=f"eve{n}"), 0.0)
    steps()  # ben is the last of them, not the first

    assert steps() == single


def test_the_board_limits_hold_behind_the_door() -> None:
    gate = Gate(LimitsConfig(commands_per_s=1.0))
    command = issued(0.0)

    assert gate.admit(command, 0.0) is None
    assert gate.admit(command, 0.0) is not None
