"""The alarm book: what is listed, what an acknowledgement does, what ends a fault."""

from __future__ import annotations

import math

from gateway.board.conditions import LINK, LOG, TO_BOARD
from gateway.views.alarms import MAX_ALARMS, MAX_ENTRIES, TWIN, AlarmBook
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag

S = 1_000_000_000  # ns


def names(book: AlarmBook) -> list[tuple[str, bool, bool]]:
    return [(a.name, a.active, a.acknowledged) for a in book.listed()]


def divergence(*, active: bool) -> pb.Alarm:
    return pb.Alarm(name="divergence-x", active=active, value=9.0, threshold_on=5.0, text="x is off")


def test_an_alarm_is_listed_until_it_is_gone_and_seen() -> None:
    book = AlarmBook("rig")

    book.twin_alarm(divergence(active=True), 10)
    came = names(book)
    book.twin_alarm(divergence(active=False), 20)
    went = names(book)
    was_acknowledged = book.acknowledge("divergence-x", "eva", 30)

    assert came == [("divergence-x", True, False)]
    assert went == [("divergence-x", False, False)]
    assert was_acknowledged
    assert names(book) == []


def test_an_alarm_that_comes_again_calls_again() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 10)
    assert book.acknowledge("divergence-x", "eva", 20)
    alarm = book.listed()[0]
    assert not book.acknowledge("divergence-x", "eva", 21)

    book.twin_alarm(divergence(active=False), 30)
    book.twin_alarm(divergence(active=True), 40)

    assert (alarm.acknowledger, alarm.value, alarm.threshold_on) == ("eva", 9.0, 5.0)
    assert names(book) == [("divergence-x", True, False)]


def test_it_counts_how_often_an_unseen_alarm_came() -> None:
    book = AlarmBook("rig")

    for n in range(3):
        book.twin_alarm(divergence(active=True), 10 * n)
        book.twin_alarm(divergence(active=False), 10 * n + 5)

    assert [a.times for a in book.listed()] == [3]


def test_a_fault_of_the_board_lasts_as_long_as_its_flag() -> None:
    book = AlarmBook("rig")

    book.event(pb.Event(name="over-current", severity="fault", text="coil off"), 1)
    book.state(pb.State(flags=Flag.FAULT, tick=2), 2)
    during = names(book)
    book.state(pb.State(tick=3), 3)

    assert during == [("over-current", True, False)]
    assert names(book) == [("over-current", False, False)]


def test_a_sample_from_before_a_fault_does_not_end_it() -> None:
    book = AlarmBook("rig")

    book.event(pb.Event(name="sensor-fault", severity="fault", session=1, tick=100), 1)
    book.state(pb.State(session=1, tick=99), 2)
    first_fault = book.fault()
    book.state(pb.State(session=1, tick=101), 3)

    assert (first_fault, book.fault()) == ("sensor-fault", "")


def test_an_event_gives_a_fault_its_name() -> None:
    book = AlarmBook("rig")

    book.state(pb.State(flags=Flag.FAULT, tick=5), 1)
    book.event(pb.Event(name="over-current", severity="fault", tick=5), 2)

    assert names(book) == [("over-current", True, False)]


def test_a_flag_without_its_event_is_a_fault_too() -> None:
    book = AlarmBook("rig")

    book.state(pb.State(flags=Flag.FAULT, tick=2), 2)

    assert names(book) == [("fault", True, False)]


def test_log_and_link_come_and_go() -> None:
    book = AlarmBook("rig")

    book.event(pb.Event(name="log-disk-full", severity="fault", text="no room"), 1)
    book.log("disk-full", 2)
    book.link("No samples arrive.", 3)
    during = {a.name: a.text for a in book.listed()}
    book.event(pb.Event(name="log-resumed"), 4)
    book.link("", 5)

    assert during == {LOG: "no room", LINK: "No samples arrive."}
    assert not any(a.active for a in book.listed())


def test_a_log_that_was_deleted_is_an_alarm_until_somebody_has_seen_it() -> None:
    book = AlarmBook("rig")

    book.event(pb.Event(name="log-removed", severity="fault", text="deleted"), 1)
    book.log("writing", 2)  # in a new part

    assert names(book) == [(LOG, False, False)]


def test_a_view_that_joins_late_learns_of_a_failing_log_from_the_status() -> None:
    book = AlarmBook("rig")

    book.log("disk-full", 1)

    assert names(book) == [(LOG, True, False)]


def test_faults_come_before_warnings_and_gone_ones_last() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(pb.Alarm(name="gone", active=True), 1)
    book.twin_alarm(pb.Alarm(name="gone", active=False), 2)
    book.twin_alarm(divergence(active=True), 3)
    book.event(pb.Event(name="sensor-fault"), 4)

    assert [a.name for a in book.listed()] == ["sensor-fault", "divergence-x", "gone"]


def test_names_from_the_bus_cannot_fill_the_memory() -> None:
    book = AlarmBook("rig")

    for n in range(10 * MAX_ALARMS):
        book.twin_alarm(pb.Alarm(name=f"made-up-{n}", active=True), n)

    assert len(book.listed()) == MAX_ALARMS


def test_the_revision_rises_with_what_is_shown_only() -> None:
    book = AlarmBook("rig")
    book.state(pb.State(tick=1), 1)
    book.link("", 1)
    quiet = book.revision

    book.link("down", 2)
    once = book.revision
    book.link("down", 3)

    assert (quiet, once, book.revision) == (0, 1, 1)


def test_an_alarm_that_was_missed_is_listed_with_its_first_time() -> None:
    book = AlarmBook("rig")
    raised = pb.Alarm(name="divergence-x", active=True, text="off", host_time_ns=100)

    book.twin_alarms(pb.TwinAlarms(active=[raised]), 900)

    assert [(a.name, a.since_ns, a.times) for a in book.listed()] == [("divergence-x", 100, 1)]


def test_a_repeated_alarm_is_no_new_one() -> None:
    book = AlarmBook("rig")
    raised = pb.Alarm(name="divergence-x", active=True, text="off", host_time_ns=100)
    book.twin_alarm(raised, 100)
    assert book.acknowledge("divergence-x", "eva", 200)
    before, revision = book.listed(), book.revision

    for n in range(3):
        book.twin_alarms(pb.TwinAlarms(active=[raised]), 300 + n)

    assert (book.listed(), book.revision) == (before, revision)


def test_what_the_twin_no_longer_lists_has_ended_and_what_others_said_has_not() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 10)
    book.event(pb.Event(name="over-current", severity="fault"), 11)

    book.twin_alarms(pb.TwinAlarms(), 20)  # of a twin that was started again

    assert names(book) == [("over-current", True, False), ("divergence-x", False, False)]


def test_the_end_of_the_twin_ends_its_alarms_and_is_one_itself() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 10)

    book.end_twin_alarms(20)
    ended_names = names(book)
    book.twin_alarms(pb.TwinAlarms(), 30)

    assert ended_names == [(TWIN, True, False), ("divergence-x", False, False)]
    assert not any(active for _, active, _ in names(book))


def test_an_acknowledgement_means_what_came_before_it() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(pb.Alarm(name="divergence-x", active=True, host_time_ns=100), 100)
    acknowledgement = pb.Acknowledgement(alarm="divergence-x", who="eva", host_time_ns=99)

    book.repeated(pb.Alarms(acknowledged=[acknowledgement]), 200)
    too_early = names(book)
    acknowledgement.host_time_ns = 101
    book.repeated(pb.Alarms(acknowledged=[acknowledgement]), 200)

    assert too_early == [("divergence-x", True, False)]
    assert names(book) == [("divergence-x", True, True)]


def test_the_gateway_gives_a_missed_fault_its_name_and_a_link_its_time() -> None:
    book = AlarmBook("rig")
    book.state(pb.State(flags=Flag.FAULT, tick=5), 900)
    book.link("No samples arrive.", 900)
    known = [pb.Alarm(name="over-current", active=True, text="coil off", host_time_ns=100),
             pb.Alarm(name=LINK, active=True, text="The cable is out.", host_time_ns=200)]  # fmt: skip

    book.repeated(pb.Alarms(active=known), 950)

    assert [(a.name, a.text, a.since_ns) for a in book.listed()] == [
        (LINK, "No samples arrive.", 200),
        ("over-current", "coil off", 100),
    ]


def test_the_gateways_list_raises_nothing_that_samples_deny() -> None:
    book = AlarmBook("rig")
    book.state(pb.State(tick=5), 900)

    book.repeated(pb.Alarms(active=[pb.Alarm(name="over-current", active=True), pb.Alarm(name=LINK, active=True)]), 950)

    assert names(book) == []


def test_a_board_that_does_not_answer_is_an_alarm_until_it_answers() -> None:
    book = AlarmBook("rig")

    book.event(pb.Event(name=TO_BOARD, severity="fault", text="cut", host_time_ns=100), 100)
    book.to_board(pb.Status(to_board="answering", host_time_ns=90), 110)  # made before, came later
    held = book.listed()[0]
    book.event(pb.Event(name="board-answers", severity="info", host_time_ns=200), 200)

    assert (held.name, held.severity, held.active, held.text) == (TO_BOARD, "fault", True, "cut")
    assert names(book) == [(TO_BOARD, False, False)]


def test_a_view_that_comes_late_learns_from_the_status_that_the_board_does_not_answer() -> None:
    book = AlarmBook("rig")

    book.to_board(pb.Status(to_board="unanswered", unanswered_s=3.0, host_time_ns=10_000_000_000), 0)
    came = book.listed()[0]
    book.to_board(pb.Status(to_board="answering", host_time_ns=11_000_000_000), 0)

    assert (came.severity, came.since_ns) == ("fault", 7_000_000_000)
    assert names(book) == [(TO_BOARD, False, False)]


def test_a_shelved_alarm_is_quiet_until_its_time_is_over_and_calls_again_then() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 10 * S)
    assert book.acknowledge("divergence-x", "eva", 20 * S, "known", shelve_s=60.0)

    def shelf() -> list[tuple[str, bool, str, int]]:
        return [(a.name, a.active, a.acknowledger, a.shelved_until_ns) for a in book.shelved()]

    assert names(book) == [("divergence-x", True, True)]
    book.twin_alarm(divergence(active=False), 30 * S)
    assert names(book) == []
    assert shelf() == [("divergence-x", False, "eva", 80 * S)]
    book.twin_alarm(divergence(active=True), 40 * S)
    assert names(book) == [("divergence-x", True, True)]

    book.expire(79 * S)
    assert names(book) == [("divergence-x", True, True)]
    book.expire(80 * S)

    assert names(book) == [("divergence-x", True, False)]
    assert shelf() == []
    assert not book.acknowledge("divergence-x", "eva", 20 * S, shelve_s=60.0, now_ns=81 * S)  # the gateway repeats it
    assert [(e.what, e.who) for e in reversed(book.journal)] == [
        ("unshelved", ""), ("came", ""), ("went", ""), ("shelved", "eva"), ("came", ""),
    ]  # fmt: skip


def test_a_shelved_alarm_that_is_gone_is_forgotten_when_its_time_is_over() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 10 * S)
    assert book.acknowledge("divergence-x", "eva", 20 * S, shelve_s=60.0)
    book.twin_alarm(divergence(active=False), 30 * S)

    book.expire(80 * S)

    assert names(book) == []
    assert not book.waits("divergence-x", shelve=True)


def test_acknowledging_a_shelved_alarm_ends_the_shelving_and_an_older_acknowledgement_does_not() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 10 * S)
    assert book.acknowledge("divergence-x", "eva", 20 * S, shelve_s=60.0)
    assert not book.acknowledge("divergence-x", "ben", 19 * S)
    assert book.waits("divergence-x")

    assert book.acknowledge("divergence-x", "ben", 25 * S)

    assert book.shelved() == ()
    assert names(book) == [("divergence-x", True, True)]
    assert not book.acknowledge("divergence-x", "eva", 20 * S, shelve_s=60.0)  # as repeated from before
    assert not book.waits("divergence-x")


def test_a_view_that_joined_late_hears_of_a_shelving_from_the_gateway() -> None:
    book = AlarmBook("rig")
    record = pb.Acknowledgement(alarm="divergence-x", who="eva", host_time_ns=20 * S, shelve_s=60.0)
    book.twin_alarm(divergence(active=True), 30 * S)  # it came again while it was shelved

    book.repeated(pb.Alarms(acknowledged=[record]), 40 * S)

    assert [(a.acknowledger, a.shelved_until_ns) for a in book.shelved()] == [("eva", 80 * S)]


def test_a_shelving_lasts_as_long_as_a_gateway_lets_it_at_most() -> None:
    book = AlarmBook("rig")
    book.twin_alarm(divergence(active=True), 1)

    book.repeated(pb.Alarms(acknowledged=[pb.Acknowledgement(alarm="divergence-x", shelve_s=math.inf)]), 40 * S)

    assert [a.shelved_until_ns for a in book.shelved()] == [40 * S + 86_400 * S]


def test_the_journal_is_bounded() -> None:
    book = AlarmBook("rig")

    for n in range(MAX_ENTRIES):
        book.twin_alarm(divergence(active=n % 2 == 0), n)
    book.twin_alarm(divergence(active=True), MAX_ENTRIES)

    assert len(book.journal) == MAX_ENTRIES
    assert book.noted == MAX_ENTRIES + 1
