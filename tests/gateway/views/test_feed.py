"""The feed on a real bus: the latest, freshness, bins, alarms, commands; junk costs nothing."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial

import pytest

from gateway.board.conditions import LINK, TO_BOARD
from gateway.views.alarms import TWIN
from gateway.views.board_feed import SILENT_S, TWIN_TIMEOUT_S, UNSEEN_S, BoardFeed
from gateway.views.decimate import TopicBins
from gateway.views.feed import Feed
from gateway.views.hmi.snapshot import rest
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import REPLAYED, batch
from tests.harness.gateway.bus_peers import PlayedGateway, feed_of, played_gateway
from tests.harness.gateway.gateway_peers import ScriptedBoard, client, gateway_config, running, wait_for


@pytest.fixture
def gateway() -> Iterator[PlayedGateway]:
    with played_gateway() as played:
        yield played


@pytest.fixture
def feed(gateway: PlayedGateway) -> Iterator[Feed]:
    with feed_of(gateway) as feed:
        yield feed


def await_feed(feed: Feed, gateway: PlayedGateway, board: str = "rig") -> BoardFeed:
    """The board, once a sample has arrived and none is under way; subscriptions take a moment to reach the router."""

    def look() -> BoardFeed | None:
        gateway.state(board)
        candidate = feed.board(board)
        return candidate if candidate is not None and candidate.latest(pb.State) is not None else None

    board_feed = wait_for(look, f"board {board} in the feed")
    wait_for(lambda: board_feed.latest(pb.State) == gateway.last, "the last sample")
    return board_feed


def test_the_latest_of_each_type_is_kept_for_each_board(feed: Feed, gateway: PlayedGateway) -> None:
    rig, other = await_feed(feed, gateway), await_feed(feed, gateway, "other")

    gateway.state(x_m=1e-3)
    gateway.state("other", x_m=2e-3)
    gateway.parameters()
    wait_for(lambda: rig.latest(pb.Parameters), "parameters")

    def x_of(board: BoardFeed) -> float:
        state = board.latest(pb.State)
        return state.x_m if state is not None else math.nan

    wait_for(lambda: (x_of(rig), x_of(other)) == (1e-3, 2e-3), "positions")
    assert feed.boards() == ("other", "rig")
    assert rig.age_s(pb.State) < 5.0
    assert rig.age_s(pb.TwinState) == math.inf
    assert feed.board("nobody") is None


def test_a_board_that_falls_silent_is_not_live_within_a_second(feed: Feed, gateway: PlayedGateway) -> None:
    rig = await_feed(feed, gateway)
    gateway.status()
    gateway.state()
    wait_for(lambda: rig.latest(pb.Status), "status")
    assert rig.link().live

    looks = [rig.link()]

    def lost() -> bool:
        looks.append(rig.link())
        return not looks[-1].live

    wait_for(lost, "loss of the board")

    # Whenever somebody looks, not when a timer comes round.
    assert SILENT_S < 1.0
    assert all(link.live == (link.age_s < SILENT_S) for link in looks)
    assert looks[-1].state == "silent"
    gateway.status(link="absent")
    assert wait_for(lambda: rig.link() if rig.link().state == "absent" else None, "absent").reason
    gateway.send("alarms", pb.Alarms(active=[pb.Alarm(name=LINK, active=True, text="There is no /dev/ttyUSB0.")]))
    wait_for(lambda: rig.link().reason == "There is no /dev/ttyUSB0.", "what the gateway says")
    wait_for(lambda: [a.text for a in rig.alarms()] == ["There is no /dev/ttyUSB0."], "the alarm, after the grace")


def test_silence_is_judged_by_the_clock_of_the_view(gateway: PlayedGateway) -> None:
    now_s = [100.0]
    with client(gateway.endpoint) as bus:
        feed = Feed(bus.session, now_s=lambda: now_s[0])
        rig = await_feed(feed, gateway)
        assert rig.link().live

        now_s[0] += 0.6
        silent = rig.link().state
        now_s[0] += 3.0
        lost_link = rig.link()
        alarms = [(a.name, a.active) for a in rig.alarms()]
        await_feed(feed, gateway)
        wait_for(lambda: rig.link().live, "samples")

        assert (silent, lost_link.state) == ("connecting", "no-gateway")
        assert alarms == [(LINK, True)]
        assert [(a.name, a.active) for a in rig.alarms()] == [(LINK, False)]
        feed.close()


def test_a_board_that_is_just_being_found_is_no_alarm(feed: Feed, gateway: PlayedGateway) -> None:
    def look() -> BoardFeed | None:
        gateway.status(link="handshake")
        return feed.board("rig")

    rig = wait_for(look, "board")

    assert rig.link().state == "handshake"
    assert rig.alarms() == ()


def test_a_tap_gets_every_spike(feed: Feed, gateway: PlayedGateway) -> None:
    rig = await_feed(feed, gateway)
    tap = rig.tap(pb.State, width_s=0.02)

    for n in range(100):
        gateway.state(x_m=9e-3 if n == 41 else 3e-3)
    bins = tap.take()

    def has_all_samples() -> bool:
        bins.extend(tap.take())
        return bool(bins) and bins[-1].message.tick > gateway.last.tick - 10  # the last bin is still open

    wait_for(has_all_samples, "all samples")

    assert max(b.high["x_m"] for b in bins) == 9e-3
    assert len(bins) < 30


def test_an_absent_value_is_nan_and_not_zero(feed: Feed, gateway: PlayedGateway) -> None:
    rig = await_feed(feed, gateway)
    tap = rig.tap(pb.State, width_s=0.002)

    gateway.state(i_c_a=None, x_m=1e-3)
    wait_for(lambda: rig.latest(pb.State) == gateway.last, "sample")
    absent = tap.take(unfinished=True)[-1]

    assert math.isnan(absent.last["i_c_a"])
    assert absent.last["x_m"] == 1e-3


def test_channels_are_the_numbers_of_the_message() -> None:
    state, divergence = (TopicBins(kind, 1, threading.Lock()) for kind in (pb.State, pb.Divergence))

    assert state.channels == ("i_c_a", "x_m", "u_c_v", "x_ref_m")
    assert {"x_m.error", "i_c_a.normalised", "nis"} <= set(divergence.channels)


def acknowledgement(alarm: str, comment: str = "") -> pb.Command:
    return pb.Command(acknowledge=pb.Acknowledge(alarm=alarm, comment=comment))


def test_alarms_of_twin_and_board_are_listed_and_acknowledged(feed: Feed, gateway: PlayedGateway) -> None:
    rig = await_feed(feed, gateway)

    gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=True, text="off"))
    wait_for(rig.alarms, "alarm")
    reply = feed.command("rig", acknowledgement("divergence-x"), who="eva")

    assert reply.accepted
    assert [(a.name, a.acknowledger) for a in rig.alarms() if a.name != LINK] == [("divergence-x", "eva")]
    assert gateway.commands[0][1].acknowledge.alarm == "divergence-x"
    assert feed.command("rig", acknowledgement("divergence-x"), who="eva").reason == "no-alarm"
    assert feed.command("nobody", acknowledgement("divergence-x"), who="eva").reason == "no-alarm"


def test_what_is_seen_in_one_view_is_seen_in_all_and_in_those_that_come_later() -> None:
    with ScriptedBoard() as board:
        config = gateway_config(board.url)
        endpoint = config.zenoh.listen[0]
        with running(config), client(endpoint) as bus, client(endpoint) as elsewhere:
            feeds = [Feed(bus.session), Feed(elsewhere.session)]
            boards = [wait_for(partial(feed.board, "rig"), "board") for feed in feeds]
            raised = pb.Alarm(name="divergence-x", active=True, text="off", host_time_ns=time.time_ns())

            def arrived() -> bool:
                for topic, message in (("alarm", raised), ("alarms", pb.TwinAlarms(active=[raised]))):
                    bus.session.put(f"board51/rig/twin/{topic}", message.SerializeToString())  # repeated: no new alarm
                return all(board.waits("divergence-x") for board in boards)

            wait_for(arrived, "alarm")

            reply = feeds[0].command("rig", acknowledgement("divergence-x", "known"), who="eva")
            confirmed = wait_for(lambda: [a for a in boards[1].alarms() if a.acknowledged], "acknowledgement elsewhere")
            feeds.append(Feed(elsewhere.session))
            new_board = wait_for(lambda: feeds[2].board("rig"), "board")
            bus.session.put("board51/rig/twin/alarms", pb.TwinAlarms(active=[raised]).SerializeToString())
            confirmed_new = wait_for(lambda: [a for a in new_board.alarms() if a.acknowledged], "acknowledgement later")
            event = bus.await_event("acknowledged")

            assert reply.accepted
            for alarm in (confirmed[0], confirmed_new[0]):
                assert (alarm.name, alarm.acknowledger, alarm.comment) == ("divergence-x", "eva", "known")
                assert alarm.since_ns == raised.host_time_ns
            assert event.text == "eva: divergence-x known"
            for feed in feeds:
                feed.close()


def test_the_alarm_that_there_is_no_gateway_can_be_acknowledged_without_one(gateway: PlayedGateway) -> None:
    now_s = [100.0]
    with client(gateway.endpoint) as bus:
        feed = Feed(bus.session, now_s=lambda: now_s[0])
        rig = await_feed(feed, gateway)
        gateway.stop_answering()
        now_s[0] += 4.0
        assert [a.name for a in rig.alarms()] == [LINK]

        reply = feed.command("rig", acknowledgement(LINK), who="eva")

        assert (reply.accepted, "this view only" in reply.text) == (True, True)
        assert [(a.name, a.acknowledger) for a in rig.alarms()] == [(LINK, "eva")]
        feed.close()


def test_a_twin_that_ends_is_an_alarm_and_its_own_alarms_end(gateway: PlayedGateway) -> None:
    now_s = [100.0]
    with client(gateway.endpoint) as bus:
        feed = Feed(bus.session, now_s=lambda: now_s[0])
        rig = await_feed(feed, gateway)
        active = pb.TwinAlarms(active=[pb.Alarm(name="divergence-x", active=True, text="off")])
        gateway.send("twin/alarms", active)
        wait_for(rig.alarms, "alarm")

        now_s[0] += TWIN_TIMEOUT_S + 1.0
        await_feed(feed, gateway)  # the gateway was away as well, and its first word may be a sample: the twin has time
        wait_for(lambda: rig.link().live, "samples")
        with_time = [(a.name, a.active) for a in rig.alarms() if a.name != LINK]
        for _ in range(5):
            now_s[0] += TWIN_TIMEOUT_S / 4.0
            await_feed(feed, gateway)  # this time it is there, and the twin is not
        end_alarms = wait_for(lambda: [a for a in rig.alarms() if a.name == TWIN], "end of the twin")

        assert with_time == [("divergence-x", True)]
        assert end_alarms[0].active
        assert not next(a for a in rig.alarms() if a.name == "divergence-x").active
        feed.close()


def test_a_command_says_who_and_comes_back_with_the_answer(feed: Feed, gateway: PlayedGateway) -> None:
    reply = feed.command("rig", pb.Command(stop=pb.Stop()), who="eva", role="operator")

    key, command = gateway.commands[0]
    assert reply.accepted
    assert reply.id == command.id
    assert (command.who, command.WhichOneof("what"), key) == ("eva", "stop", "board51/rig/command")


def test_junk_on_the_bus_is_counted_and_changes_nothing(feed: Feed, gateway: PlayedGateway) -> None:
    rig = await_feed(feed, gateway)

    gateway.put("states", b"\xff\xff\xff")
    wait_for(lambda: feed.refused, "refusal")
    for n in range(200):
        gateway.send("status", pb.Status(), f"made-up-{n}")
    wait_for(lambda: feed.refused > 100, "refusals")

    assert len(feed.boards()) <= 64
    assert rig.latest(pb.State) is not None


def test_a_board_behind_a_real_gateway_is_lost_and_found() -> None:
    with ScriptedBoard() as board:
        config = gateway_config(board.url)
        endpoint = config.zenoh.listen[0]
        with running(config), client(endpoint) as bus:
            feed = Feed(bus.session)
            rig = wait_for(lambda: feed.board("rig"), "board")
            wait_for(lambda: rig.link().live, "samples")

            board.streaming = False
            wait_for(lambda: not rig.link().live, "loss")
            board.streaming = True
            wait_for(lambda: rig.link().live, "samples again")
            feed.close()


def test_a_view_finds_a_gateway_that_was_restarted() -> None:
    with ScriptedBoard() as board, ExitStack() as stack:
        config = gateway_config(board.url)
        with running(config):
            bus = stack.enter_context(client(config.zenoh.listen[0]))
            feed = Feed(bus.session)
            rig = wait_for(lambda: feed.board("rig"), "board")
            wait_for(lambda: rig.link().live, "samples")
        wait_for(lambda: not rig.link().live, "loss")

        # By their time: on a busy machine, late samples of the first gateway may follow the loss.
        began_ns = time.time_ns()

        def sampled() -> bool:
            state = rig.latest(pb.State)
            return state is not None and state.host_time_ns > began_ns and rig.link().live

        with running(config):
            wait_for(sampled, "samples of the new gateway")
            assert feed.command("rig", pb.Command(ping=pb.Ping()), who="test").accepted
            feed.close()


def test_a_board_that_does_not_answer_is_an_alarm_while_its_samples_are_live(
    feed: Feed, gateway: PlayedGateway
) -> None:
    rig = await_feed(feed, gateway)

    def unanswered(*, active: bool) -> bool:
        gateway.state()
        return any(a.name == TO_BOARD and a.severity == "fault" and a.active == active for a in rig.alarms())

    gateway.send("status", pb.Status(link="streaming", to_board="unanswered", unanswered_s=2.0, host_time_ns=10**18))
    wait_for(lambda: unanswered(active=True), "the alarm")
    live, rest_status = rig.link().live, rest(rig)["status"]
    gateway.send("status", pb.Status(link="streaming", to_board="answering", host_time_ns=10**18 + 1))
    wait_for(lambda: unanswered(active=False), "its end")

    assert live
    assert rest_status["to_board"] == "unanswered"


def test_a_rig_that_is_unseen_for_minutes_can_be_removed_and_comes_back_by_itself(gateway: PlayedGateway) -> None:
    now_s = [100.0]
    with client(gateway.endpoint) as bus:
        feed = Feed(bus.session, now_s=lambda: now_s[0])
        rig = await_feed(feed, gateway)
        now_s[0] += UNSEEN_S - 1.0
        assert (feed.remove("rig"), feed.remove("nobody")) == (False, False)
        now_s[0] += 2.0

        assert feed.remove("rig")

        assert feed.boards() == ()
        assert await_feed(feed, gateway) is not rig
        feed.close()


def test_what_is_replayed_is_no_board_of_the_live_site_and_the_only_one_of_replays(gateway: PlayedGateway) -> None:
    """Nor is what a twin makes of it."""
    state = pb.State(tick=1, session=1)
    with client(gateway.endpoint) as bus:
        live, replays = Feed(bus.session), Feed(bus.session, replays=True)

        def reached() -> bool:
            gateway.send("twin/state", pb.TwinState(tick=1), "demo")
            gateway.session.put("board51/demo/states", batch("state", [state.SerializeToString()]), attachment=REPLAYED)
            gateway.state()
            return bool(live.boards() and replays.boards())

        wait_for(reached, "a message in both")

        assert (live.boards(), replays.boards()) == (("rig",), ("demo",))
        for feed in (live, replays):
            feed.close()


def test_the_last_stop_of_a_board_is_known_whoever_sent_it(gateway: PlayedGateway) -> None:
    now_s = [100.0]
    with client(gateway.endpoint) as bus:
        feed = Feed(bus.session, now_s=lambda: now_s[0])
        await_feed(feed, gateway)
        assert feed.stopped_s("rig") == feed.stopped_s("nobody") == -math.inf
        now_s[0] = 123.0

        gateway.send("command/record", pb.CommandRecord(command=pb.Command(who="eva", stop=pb.Stop())))

        wait_for(lambda: feed.stopped_s("rig") == 123.0, "the STOP")
        feed.close()
