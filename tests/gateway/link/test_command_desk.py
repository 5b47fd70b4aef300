"""Commands between bus and board, on times that the test makes: STOP, ids, ages, faults of ours."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.access.authorize import MAX_AGE_S, Sender
from gateway.access.roles import Role
from gateway.board.limits import MAX_STOP
from gateway.board.scaling import scaling_of
from gateway.config import LimitsConfig
from gateway.link.command_handler import RETAINED_IDS, RETAINED_S, CommandHandler
from gateway.link.from_board import Known
from protocol.bus import board51_pb2 as pb
from protocol.wire.decoder import StreamDecoder
from protocol.wire.events import Answer, Opened
from protocol.wire.messages import ROW_OF_NAME, Message
from protocol.wire.session import Session
from tests.harness.gateway.gateway_peers import Collector, frame, identity_values
from tests.harness.protocol.port import take_output

S = 1_000_000_000
START_NS = 1_700_000_000 * S


class Rig:
    """A command handler, its session, and a board that the test plays."""

    def __init__(self, **limits: Any) -> None:
        self.now_s = 100.0
        self.sink, self.known = Collector(), Known()
        self.session = Session(choose_session=lambda: 7)
        options = {"commands_per_s": 1000.0, **limits}
        self.handler = CommandHandler(LimitsConfig(**options), self.session, self.known, self.sink, lambda *_: None)
        self.wire: list[Message] = []
        self.ends: list[Answer] = []
        self.tick = 5000
        self.stepped_s = 0.0  # the wall clock
        self.answering = True
        self.session.connect(self.now_s)
        self.session.poll(self.now_s)
        (hello,) = StreamDecoder().feed(take_output(self.session))
        assert isinstance(hello, Message)
        (opened,) = self.session.feed(
            frame("IDENTITY", id=hello.int("id"), tick=self.tick, **identity_values()), self.now_s
        )
        assert isinstance(opened, Opened)
        scaling = scaling_of(opened.identity)
        assert not isinstance(scaling, str), scaling
        self.known.identity, self.known.scaling = opened.identity, scaling

    @property
    def now_ns(self) -> int:
        return START_NS + round((self.now_s + self.stepped_s) * S)

    @property
    def records(self) -> list[pb.CommandRecord]:
        return self.sink.messages["command/record"]

    def ask(self, payload: bytes, *, role: Role | None = None, link: str = "streaming") -> list[pb.CommandReply]:
        """The replies so far to a query; the board has had its say."""
        replies: list[pb.CommandReply] = []
        sender = Sender(name="ben", role=role, arrived_ns=self.now_ns, arrived_s=self.now_s, started_ns=START_NS)
        self.handler.take(payload, replies.append, self.now_s, self.now_ns, link=link, reason="", sender=sender)
        self.settle()
        return replies

    def command(self, **fields: Any) -> pb.CommandReply:
        (reply,) = self.ask(pb.Command(**fields).SerializeToString())
        return reply

    def settle(self) -> None:
        """What the handler sends, answered until there is nothing more to say."""
        while True:
            for event in self.session.take_outcomes():
                assert isinstance(event, Answer)
                self.handler.answered(event, self.now_ns)
            heard = [m for m in StreamDecoder().feed(take_output(self.session)) if isinstance(m, Message)]
            self.wire += heard
            if not heard or not self.answering:
                return
            for message in heard:
                self.tick += 1
                for event in self.session.feed(self._answer(message), self.now_s):
                    if isinstance(event, Answer):
                        self.handler.answered(event, self.now_ns)

    def _answer(self, message: Message) -> bytes:
        number = message.int("id")
        if message.name == "PING":
            return frame("PONG", id=number, tick=self.tick, bad_frames=0, overruns=0)
        return frame("ACK", id=number, command=ROW_OF_NAME[message.name].type, tick=self.tick)

    def wait(self, seconds: float) -> None:
        """Let time pass in steps that a poll would make."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s = min(end_s, max(self.now_s + 0.01, min(self.session.deadline_s, end_s)))
            for event in self.session.poll(self.now_s):
                assert isinstance(event, Answer)
                self.handler.answered(event, self.now_ns)
            self.settle()

    def sent(self, name: str) -> int:
        return [message.name for message in self.wire].count(name)


CLOSED = pb.SetMode(mode=pb.MODE_CLOSED_LOOP)


# -- STOP


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
    rig.ask(pb.Command(id="stop", stop=pb.Stop()).SerializeToString(), link=link)
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
    late = pb.Command(id="late", set_mode=CLOSED).SerializeToString()

    rig.handler.take(late, replies.append, rig.now_s, rig.now_ns, link="streaming", reason="", sender=sender)
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

    (reply,) = rig.ask(pb.Command(**fields, stop=pb.Stop()).SerializeToString(), role=Role.OPERATOR)

    assert reply.accepted, reply.text
    assert rig.sent("STOP") == 1


def test_neither_flood_nor_a_full_queue_keeps_a_stop_from_the_board() -> None:
    rig = Rig(commands_per_s=40.0)
    rig.answering = False
    refused = [rig.ask(pb.Command(id=f"p{n}", ping=pb.Ping()).SerializeToString()) for n in range(60)]
    assert {r.reason for replies in refused for r in replies} == {"flood", "queue-full"}

    rig.answering = True
    (reply,) = rig.ask(pb.Command(id="p0", stop=pb.Stop()).SerializeToString())

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

    assert rig.ask(pb.Command(stop=pb.Stop()).SerializeToString(), link=link)[0].accepted
    assert rig.ask(pb.Command(stop=pb.Stop()).SerializeToString(), link="absent")[0].reason == "link-down"


# -- once


@pytest.mark.parametrize("others", [0, RETAINED_IDS + 10])
def test_a_dated_command_is_executed_once_however_late_it_comes_again(others: int) -> None:
    rig = Rig()
    command = pb.Command(id="a", issued_ns=rig.now_ns, set_mode=CLOSED)
    (first,) = rig.ask(command.SerializeToString())
    reasons = []
    for k in range(12):
        rig.wait(2.5)
        for n in range(others):
            assert rig.command(id=f"p{k}-{n}", ping=pb.Ping()).accepted
        (again,) = rig.ask(command.SerializeToString())
        reasons.append(again.reason)
        assert again == first or again.reason == "not-fresh"

    assert first.accepted
    assert rig.sent("SET_MODE") == 1
    assert reasons[0] == ""
    assert reasons[-1] == ("not-fresh" if others else "")


def test_an_undated_command_is_executed_once_until_the_reply_says() -> None:
    rig = Rig()
    command = pb.Command(id="a", set_mode=CLOSED).SerializeToString()
    (first,) = rig.ask(command)
    assert first.repeat_until_ns == rig.now_ns + round(RETAINED_S * S)
    for n in range(RETAINED_IDS):
        rig.command(id=f"p{n}", ping=pb.Ping())

    rig.wait(RETAINED_S - 0.1)
    assert rig.ask(command) == [first]
    rig.wait(0.2)
    for n in range(RETAINED_IDS):
        rig.command(id=f"q{n}", ping=pb.Ping())
    (late,) = rig.ask(command)

    assert late.tick > first.tick  # executed again: that is what the reply said, and why a command should be dated
    assert rig.sent("SET_MODE") == 2


@pytest.mark.parametrize("role", [None, Role.OPERATOR])
def test_a_dated_command_expires_on_every_bus(role: Role | None) -> None:
    rig = Rig()
    rig.wait(30.0)
    old, brief, new = (
        pb.Command(id=str(n), issued_ns=rig.now_ns - round(age_s * S), valid_s=valid_s, set_mode=CLOSED)
        for n, (age_s, valid_s) in enumerate([(MAX_AGE_S + 0.1, 60.0), (3.0, 2.0), (3.0, 0.0)])
    )

    replies = [rig.ask(command.SerializeToString(), role=role)[0] for command in (old, brief, new)]

    assert [reply.reason for reply in replies] == ["not-fresh", "not-fresh", ""]
    assert replies[0].repeat_until_ns == 0


# -- nothing acts later


def test_a_reply_says_whether_a_byte_went_out_and_what_never_did_may_be_tried_again() -> None:
    rig = Rig()
    rig.answering = False
    sent = pb.Command(id="a", set_mode=CLOSED).SerializeToString()
    assert rig.ask(sent) == []
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
    assert rig.ask(later)[0].accepted  # nothing was executed: the same id is good


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


# -- faults of ours


def test_a_fault_in_a_handler_costs_one_command_and_it_is_answered_and_recorded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig()
    assert rig.known.scaling is not None
    good, rig.known.scaling = rig.known.scaling, replace(rig.known.scaling, x_lsb_m=0.0)  # no board is let in with it

    reply = rig.command(id="a", set_reference=pb.SetReference(x_ref_m=1e-3))
    rig.known.scaling = good

    assert (reply.id, reply.refused_by, reply.reason) == ("a", "gateway", "internal-error")
    assert [record.command.id for record in rig.records] == ["a"]
    assert "ZeroDivisionError" in caplog.text
    assert rig.command(id="a", set_reference=pb.SetReference(x_ref_m=1e-3)).accepted


PLANT = pb.Plant(name="rig", mass_kg=20e-3, travel_m=12e-3, x_max_m=16e-3, gravity_m_s2=9.81)


@pytest.mark.parametrize(("role", "accepted"), [(Role.VIEWER, False), (Role.OPERATOR, False), (Role.ENGINEER, True)])
def test_only_an_engineer_states_the_plant_and_a_stop_does_not_give_it_up(role: Role, accepted: bool) -> None:
    rig = Rig()
    rig.now_s += 10.0
    asked = pb.Command(id="1", issued_ns=rig.now_ns, set_plant=pb.SetPlant(plant=PLANT)).SerializeToString()
    rig.ask(pb.Command(stop=pb.Stop()).SerializeToString(), role=role)

    (reply,) = rig.ask(asked, role=role)

    assert reply.accepted == accepted
    assert reply.reason == ("" if accepted else "not-allowed")
    assert rig.handler.plant_card.card.who == ("ben" if accepted else "")
    assert [event.text for event in rig.sink.messages["event"]] == accepted * [
        "ben: a ball of 20 g, travel 12 mm, x_max 16 mm, g 9.81 m/s2; before: not stated"
    ]


DOUBLES = st.floats() | st.sampled_from([0.0, 5e-324, -5e-324, 1e308, -1e308, 2.0**53, 1e-9])
UINTS = st.integers(0, 2**32 - 1)
ENUMS = st.integers(-(2**31), 2**31 - 1) | st.integers(-1, 8)
KINDS = {
    "set_mode": st.builds(pb.SetMode, mode=ENUMS),
    "set_reference": st.builds(pb.SetReference, x_ref_m=DOUBLES),
    "set_gains": st.builds(
        pb.SetGains, law=ENUMS, gains=st.lists(DOUBLES, min_size=3, max_size=5), i_0_a=DOUBLES, x_0_m=DOUBLES,
        u_0_v=DOUBLES,
    ),
    "excite": st.builds(
        pb.Excite, shape=ENUMS, on_reference=st.booleans(), amplitude=DOUBLES, offset=st.none() | DOUBLES,
        period_s=DOUBLES, period_end_s=DOUBLES, seed=UINTS, duration_s=DOUBLES,
    ),
    "capture": st.builds(pb.Capture, u_from_v=DOUBLES, u_to_v=DOUBLES, duration_s=DOUBLES, pre_s=DOUBLES),
    "set_stream": st.builds(pb.SetStream, divider=UINTS),
    "set_host_loss": st.builds(pb.SetHostLoss, policy=UINTS, timeout_s=DOUBLES),
    "stop": st.just(pb.Stop()),
    "ping": st.just(pb.Ping()),
    "mark": st.builds(pb.Mark, text=st.text(max_size=300)),
    "acknowledge": st.builds(pb.Acknowledge, alarm=st.text(max_size=100), comment=st.text(max_size=300)),
    "set_plant": st.builds(
        pb.SetPlant, confirmed=st.booleans(),
        plant=st.none() | st.builds(
            pb.Plant, name=st.text(max_size=70), mass_kg=DOUBLES, travel_m=DOUBLES, x_max_m=DOUBLES,
            gravity_m_s2=DOUBLES, ball_diameter_m=st.none() | DOUBLES,
        ),
    ),
}  # fmt: skip
COMMANDS = st.one_of(
    [
        st.builds(
            pb.Command, id=st.text(min_size=1, max_size=130), who=st.text(max_size=130), valid_s=DOUBLES,
            issued_ns=st.sampled_from([0, START_NS + 100 * S]), **{kind: values},
        )
        for kind, values in KINDS.items()
    ]
)  # fmt: skip


def test_the_commands_of_the_property_are_all_that_there_are() -> None:
    assert set(KINDS) == {field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields}


@pytest.mark.slow
@settings(max_examples=800, suppress_health_check=[HealthCheck.too_slow])
@given(command=COMMANDS, flags=st.sampled_from([0, 1, 2, 0x82]))
def test_whatever_a_command_says_it_is_answered_with_its_id_and_recorded(command: pb.Command, flags: int) -> None:
    rig = Rig()
    for n in range(2):
        for event in rig.session.feed(
            frame("STATE", sequence=rig.tick + n, i_c=1, x=2, u_c=3, x_ref=1000, flags=flags), rig.now_s
        ):
            rig.known.sample = event  # type: ignore[assignment]  # samples alone come of states
    rig.now_s += 0.01

    (reply,) = rig.ask(command.SerializeToString())

    (record,) = rig.records
    is_stop = command.WhichOneof("what") == "stop"
    assert reply.id == (command.id[:128] if is_stop else command.id)
    assert reply.reason != "internal-error", reply.text
    assert reply.accepted or (reply.reason and reply.text)
    assert record.reply == reply


def test_bytes_of_any_kind_are_answered_and_recorded() -> None:
    rng, rig = random.Random(5), Rig()
    good = pb.Command(id="a", who="b", excite=pb.Excite(shape=pb.SHAPE_PRBS, offset=1.0)).SerializeToString()
    for n in range(3000):
        data = bytearray(good + rng.randbytes(rng.randrange(8)))
        for _ in range(rng.randrange(5)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        rig.now_s += 0.01

        rig.ask(bytes(data))
        rig.handler._retained.clear()

        assert len(rig.records) == n + 1
        assert rig.records[-1].reply.reason != "internal-error"
