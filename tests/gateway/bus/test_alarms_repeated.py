"""`alarms` of a real gateway: what is wrong since when, and who has seen what, for subscribers that come late."""

from __future__ import annotations

from pathlib import Path

import pytest

import board51
from gateway.board.conditions import EVERY_S, LINK, TO_BOARD, Condition, Standing
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from protocol.wire.messages import EventCode, Flag
from tests.harness.gateway.gateway_peers import (
    Bus,
    ScriptedBoard,
    client,
    frame,
    gateway_and_client,
    gateway_config,
    running,
    wait_for,
)


def newest(bus: Bus) -> pb.Alarms:
    alarms: list[pb.Alarms] = bus.messages["rig/alarms"]
    return alarms[-1] if alarms else pb.Alarms()


def active(bus: Bus) -> dict[str, int]:
    return {alarm.name: alarm.host_time_ns for alarm in newest(bus).active}


def test_a_fault_has_its_name_and_the_time_of_its_event_until_the_flag_falls() -> None:
    with ScriptedBoard() as board, gateway_and_client(gateway_config(board.url)) as bus:
        board.flags = int(Flag.FAULT)
        board.send(frame("EVENT", number=0, tick=board.tick, code=int(EventCode.OVER_CURRENT), detail=4095))
        event = bus.await_event("over-current")

        wait_for(lambda: active(bus) == {"over-current": event.host_time_ns}, "the fault")
        board.flags = 0
        wait_for(lambda: not active(bus), "its end")


@pytest.mark.slow
def test_a_link_that_is_down_says_since_when_and_why(tmp_path: Path) -> None:
    config = gateway_config(str(tmp_path / "nothing"))
    with running(config), client(config.zenoh.listen[0]) as early:
        since = wait_for(lambda: active(early).get(LINK), "link-down")
        with client(config.zenoh.listen[0]) as newcomer:
            wait_for(lambda: newest(newcomer).active, "link-down for who came late")

            assert active(newcomer) == {LINK: since}
            assert "nothing" in newest(newcomer).active[0].text


@pytest.mark.slow
def test_a_cut_line_to_the_board_is_an_alarm_and_a_state_of_its_own_while_samples_flow() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        bus.await_states(100)
        emulator.inject("lost=1@0+4:rx")
        event = bus.await_event(TO_BOARD)
        wait_for(lambda: active(bus) == {TO_BOARD: event.host_time_ns}, "the alarm")
        cut = wait_for(
            lambda: next((s for s in bus.messages["rig/status"] if s.to_board == "unanswered"), None), "the status"
        )
        bus.await_event("board-answers")
        wait_for(lambda: not active(bus), "its end")
        healthy = wait_for(
            lambda: next((s for s in reversed(bus.messages["rig/status"]) if s.to_board == "answering"), None), "status"
        )

    assert (cut.link, cut.samples_per_s > 0) == ("streaming", True)
    assert cut.unanswered_s >= 1.0
    assert healthy.unanswered_s == 0.0


@pytest.mark.slow
def test_every_state_frame_is_a_sample_of_the_status_or_counted_in_it() -> None:
    faults = ("reset@2/1.5", "flip=2e-4:tx", "lost=2e-4:tx", "duplicate=1e-4:tx")
    with Emulator(faults=faults) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        status = wait_for(
            lambda: next((s for s in bus.messages["rig/status"] if s.board_resets >= 4), None), "four restarts", 60.0
        )

    waiting = status.states - status.samples - sum(status.states_ignored.values())
    assert 0 <= waiting <= 2
    assert status.samples > 1000
    assert status.states_ignored["no-session"] > 0


def test_an_alarm_is_shelved_and_brought_back_from_the_command_line() -> None:
    with ScriptedBoard() as board:
        config = gateway_config(board.url)
        with gateway_and_client(config) as bus:
            send = ("send", "rig", "--connect", config.zenoh.listen[0])
            codes = [
                board51.main([*send[:2], *words, *send[2:]])
                for words in (
                    ("shelve", "innovation", "--for", "600", "--comment", "cold"),
                    ("unshelve", "innovation"),
                    ("shelve", "innovation", "--for", "86401"),
                )
            ]
            wait_for(lambda: bus.event("acknowledged"), "both events")
            texts = [bus.await_event(name).text.partition(": ")[2] for name in ("shelved", "acknowledged")]
            with pytest.raises(SystemExit):
                board51.main([*send[:2], "shelve", "innovation", "--for", "0", *send[2:]])

    assert codes == [0, 0, 1]
    assert texts[0].startswith("innovation")
    assert "cold" in texts[0]
    assert texts[1].strip() == "innovation"


def test_an_acknowledgement_is_an_event_a_record_and_kept(tmp_path: Path) -> None:
    with ScriptedBoard() as board:
        config = gateway_config(board.url, log=tmp_path)
        with gateway_and_client(config) as bus:
            first = bus.command("a", acknowledge=pb.Acknowledge(alarm="divergence-x", comment="cold coil"))
            second = bus.command("b", acknowledge=pb.Acknowledge(alarm="divergence-x"))
            shelved = bus.command("c", acknowledge=pb.Acknowledge(alarm="innovation", shelve_s=600.0))
            too_long = bus.command("d", acknowledge=pb.Acknowledge(alarm="innovation", shelve_s=1e6))
            event = bus.await_event("acknowledged")
            with client(config.zenoh.listen[0]) as newcomer:
                wait_for(lambda: len(newest(newcomer).acknowledged) > 1, "acknowledgements for who came late")
                retained = list(newest(newcomer).acknowledged)

    assert first.accepted
    assert second.accepted
    assert event.text == "test: divergence-x cold coil"
    assert shelved.accepted
    assert (too_long.accepted, too_long.reason) == (False, "out-of-range")
    assert [(entry.alarm, entry.who, entry.comment, entry.shelve_s) for entry in retained] == [
        ("divergence-x", "test", "", 0.0),  # the latest of a name
        ("innovation", "test", "", 600.0),
    ]
    logged = [m.message for log in tmp_path.glob("*.mcap") for m in read(log)]
    records = [m for m in logged if isinstance(m, pb.CommandRecord) and m.command.id == "a"]
    assert [(r.command.who, r.command.acknowledge.alarm) for r in records] == [("test", "divergence-x")]
    assert board.names().count("ACKNOWLEDGE") == 0


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        (pb.Acknowledge(), "malformed"),
        (pb.Acknowledge(alarm="x" * 65), "malformed"),
        (pb.Acknowledge(alarm="divergence-x", comment="x" * 201), "oversize"),
    ],
    ids=["no name", "a long name", "a long comment"],
)
def test_an_acknowledgement_that_cannot_be_kept_is_refused(what: pb.Acknowledge, reason: str) -> None:
    with ScriptedBoard() as board, gateway_and_client(gateway_config(board.url)) as bus:
        assert bus.command("a", acknowledge=what).reason == reason


def test_it_is_told_on_change_and_every_five_seconds() -> None:
    standing, wrong = Standing(), {LINK: Condition(text="out")}

    alarms = [
        standing.due_message(holding, [], host_ns=1000 + n, now_s=at_s)
        for n, (holding, at_s) in enumerate(
            [({}, 0.0), ({}, 1.0), (wrong, 2.0), (wrong, 3.0), (wrong, 2.0 + EVERY_S), ({}, 8.0)]
        )
    ]

    assert [message is not None for message in alarms] == [True, False, True, False, True, True]
    assert [a.host_time_ns for m in alarms if m is not None for a in m.active] == [1002, 1002], "when it was first seen"
