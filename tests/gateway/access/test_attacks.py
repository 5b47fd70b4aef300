"""Attacks on a guarded bus, from within it: with a valid identity, but not the right.  Each must change nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.access.authorize import BURST, MAX_AGE_S, MAX_AHEAD_S
from gateway.access.bus_rules import LARGEST_COMMAND, LARGEST_MESSAGE
from gateway.access.folder import SecurityFolder
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import read
from tests.harness.gateway.access_peers import Client, GuardedRig, fresh, guarded_rig
from tests.harness.gateway.gateway_peers import ScriptedBoard, gateway_and_client, gateway_config, wait_for
from tests.patience import HANG_S

pytestmark = pytest.mark.xdist_group("guarded-bus")
CLOSED = pb.SetMode(mode=pb.MODE_CLOSED_LOOP)
FORGED = 666  # session number that no board had


@pytest.fixture(scope="module")
def witness(rig: GuardedRig) -> Iterator[Client]:
    """Somebody who is there all the time."""
    with rig.join("ana") as client:
        yield client


def person(name: str) -> Any:
    """A fixture: a new session of this person for each test."""

    @pytest.fixture(name=name)
    def joined(rig: GuardedRig) -> Iterator[Client]:
        with rig.join(name) as client:
            yield client

    return joined


ana, ben, vic = person("ana"), person("ben"), person("vic")


@pytest.fixture(autouse=True)
def check_service(request: pytest.FixtureRequest) -> Iterator[None]:
    """Whatever was tried: samples go on, and an honest command is accepted."""
    client: Client | None = request.getfixturevalue("witness") if "rig" in request.fixturenames else None
    yield
    if client is not None:
        count = len(client.states)
        wait_for(lambda: len(client.states) > count + 10, "states after the attack")
        wait_for(lambda: (r := client.command(ping=pb.Ping())) is not None and r.accepted, "an accepted command")


def sent_to(board: ScriptedBoard, name: str) -> int:
    return board.names().count(name)


# -- samples


def test_nobody_but_the_gateway_says_what_was_acknowledged(rig: GuardedRig, vic: Client, ana: Client) -> None:
    received: list[bytes] = []
    vic.session.declare_subscriber("board51/*/alarms", lambda sample: received.append(sample.payload.to_bytes()))
    with rig.join("gateway") as gateway:

        def arrived() -> bool:
            for client, who in ((ana, "forger"), (gateway, "gateway")):
                message = pb.Alarms(acknowledged=[pb.Acknowledgement(alarm="x", who=who)])
                client.session.put("board51/rig/alarms", message.SerializeToString())
            return "gateway" in acknowledging_users(received)

        wait_for(arrived, "the gateway's list")
    assert "forger" not in acknowledging_users(received)


def acknowledging_users(received: list[bytes]) -> list[str]:
    return [entry.who for data in received for entry in pb.Alarms.FromString(data).acknowledged]


GATEWAY_TOPICS = ("state", "states", "status", "event", "parameters", "alarms", "capture", "command/record")


@pytest.mark.parametrize("spoofer", ["vic", "ben", "ana", "views", "twin"])
def test_nobody_but_the_gateway_publishes_what_is_the_gateway_s(rig: GuardedRig, vic: Client, spoofer: str) -> None:
    forged, received = pb.State(session=FORGED).SerializeToString(), []
    vic.session.declare_subscriber("board51/**", lambda sample: received.append(sample.payload.to_bytes()))
    with rig.join(spoofer) as attacker:
        for topic in GATEWAY_TOPICS:
            attacker.session.put(f"board51/rig/{topic}", forged)
        attacker.session.put("board51/other/state", forged)
        count = len(vic.states)
        wait_for(lambda: len(vic.states) > count + 50, "real states after the forged ones")

    assert len(received) > 50
    assert forged not in received


@pytest.mark.parametrize("topic", GATEWAY_TOPICS)
def test_a_forged_message_would_have_been_seen(rig: GuardedRig, vic: Client, topic: str) -> None:
    forged, received = pb.State(session=FORGED).SerializeToString(), []
    vic.session.declare_subscriber(f"board51/*/{topic}", lambda sample: received.append(sample.payload.to_bytes()))
    with rig.join("gateway") as holder_of_the_key:

        def arrived() -> bool:
            holder_of_the_key.session.put(f"board51/rig/{topic}", forged)
            return forged in received

        wait_for(arrived, "what was put with the gateway's identity")


@pytest.mark.parametrize("topic", ["twin/alarm", "twin/alarms"])
def test_nobody_but_the_twin_publishes_an_alarm(rig: GuardedRig, vic: Client, ana: Client, topic: str) -> None:
    received: list[bytes] = []
    vic.session.declare_subscriber(f"board51/*/{topic}", lambda sample: received.append(sample.payload.to_bytes()))
    with rig.join("twin") as twin:

        def arrived() -> bool:
            for client, name in ((ana, "forged"), (twin, "divergence-x")):
                alarm = pb.Alarm(name=name, active=True)
                message = alarm if topic == "twin/alarm" else pb.TwinAlarms(active=[alarm])
                client.session.put(f"board51/rig/{topic}", message.SerializeToString())
            return any(b"divergence-x" in data for data in received)

        wait_for(arrived, "the twin's alarm")
    assert not any(b"forged" in data for data in received)


def test_nobody_else_holds_the_token_that_says_alive(vic: Client, ana: Client) -> None:
    token = ana.session.liveliness().declare_token("board51/ghost/alive")

    replies = vic.session.liveliness().get("board51/*/alive")

    assert [str(reply.ok.key_expr) for reply in replies if reply.ok is not None] == ["board51/rig/alive"]
    del token


# -- commands of others


def test_a_false_gateway_hears_no_commands(vic: Client, ben: Client) -> None:
    queries: list[zenoh.Query] = []
    for key in ("board51/rig/command", "board51/rig/command/as/**", "board51/**"):
        vic.session.declare_queryable(key, queries.append, complete=True)

    reply = ben.command(set_mode=CLOSED)

    assert reply is not None
    assert reply.accepted
    assert queries == []


@pytest.mark.parametrize(
    "key",
    [
        "board51/rig/command",
        "board51/rig/command/as/operator/ana",
        "board51/rig/command/as/engineer/ana",
        "board51/rig/command/as/engineer/ben",
        "board51/rig/command/as/*/*",
        "board51/rig/command/as/**",
        "board51/**",
        "board51/rig/twin/command/as/engineer/ben",
    ],
)
def test_nobody_sends_as_somebody_else(rig: GuardedRig, ben: Client, key: str) -> None:
    before = sent_to(rig.board, "SET_GAINS")

    assert ben.command(key=key, set_gains=pb.SetGains(gains=[0, 0, 0, 0])) is None

    assert sent_to(rig.board, "SET_GAINS") == before


def test_the_name_in_the_message_counts_for_nothing(ben: Client) -> None:
    command = fresh(who="ana", role="engineer", ping=pb.Ping())

    assert ben.request(command.SerializeToString())[0].accepted

    record = ben.record_of(command.id)
    assert (record.command.who, record.command.role) == ("ben", "operator")


@pytest.mark.parametrize(
    ("name", "what", "needs"),
    [
        ("vic", {"set_mode": CLOSED}, "operator"),
        ("vic", {"acknowledge": pb.Acknowledge(alarm="divergence-x")}, "operator"),
        ("vic", {"set_reference": pb.SetReference(x_ref_m=0.003)}, "operator"),
        ("ben", {"set_gains": pb.SetGains(gains=[0, 0, 0, 0])}, "engineer"),
        ("ben", {"set_host_loss": pb.SetHostLoss(policy=0, timeout_s=1.0)}, "engineer"),
        ("ben", {"set_stream": pb.SetStream(divider=1000)}, "engineer"),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_a_command_without_the_right_is_refused_and_logged(
    rig: GuardedRig, name: str, what: dict[str, Any], needs: str
) -> None:
    wire_name = next(iter(what)).upper()
    before = sent_to(rig.board, wire_name)
    with rig.join(name) as attacker:
        command = fresh(**what)

        (reply,) = attacker.request(command.SerializeToString())

        assert (reply.accepted, reply.refused_by, reply.reason) == (False, "gateway", "not-allowed")
        assert needs in reply.text
        assert attacker.record_of(command.id).command.who == name
    assert sent_to(rig.board, wire_name) == before


def test_everybody_who_is_let_in_may_stop(rig: GuardedRig) -> None:
    before = sent_to(rig.board, "STOP")
    with rig.join("vic") as viewer:
        command = fresh(stop=pb.Stop())

        (reply,) = viewer.request(command.SerializeToString())

        assert reply.accepted, reply.text
        record = viewer.record_of(command.id)
    assert (record.command.who, record.command.role) == ("vic", "viewer")
    assert sent_to(rig.board, "STOP") == before + 1


def test_the_views_send_for_whom_they_have_checked(rig: GuardedRig) -> None:
    with rig.join("views") as views:
        operator = views.command(key="board51/rig/command/as/operator/eva", ping=pb.Ping())
        viewer = views.command(key="board51/rig/command/as/viewer/eva", set_mode=CLOSED)
        nobody = views.command(key="board51/rig/command/as/admin/eva", stop=pb.Stop())

    assert operator is not None
    assert operator.accepted
    for refused in (viewer, nobody):
        assert refused is not None
        assert refused.reason == "not-allowed"


# -- replay


def test_the_same_bytes_are_executed_once(rig: GuardedRig, ben: Client) -> None:
    payload = fresh(set_mode=CLOSED).SerializeToString()
    (first,) = ben.request(payload)
    before = sent_to(rig.board, "SET_MODE")

    (again,) = ben.request(payload)

    assert first.accepted
    assert again == first  # what became of it, not once more
    assert sent_to(rig.board, "SET_MODE") == before


def test_the_same_id_for_something_else_is_refused(ben: Client) -> None:
    command = fresh(ping=pb.Ping())
    assert ben.request(command.SerializeToString())[0].accepted
    command.set_mode.CopyFrom(CLOSED)

    assert ben.request(command.SerializeToString())[0].reason == "id-reused"


@pytest.mark.parametrize("age_s", [MAX_AGE_S + 1.0, -(MAX_AHEAD_S + 1.0), 1e9, None], ids=str)
def test_an_old_a_future_and_an_undated_command_are_refused(rig: GuardedRig, ben: Client, age_s: float | None) -> None:
    issued_ns = 0 if age_s is None else round(time.time_ns() - age_s * 1e9)
    before = sent_to(rig.board, "SET_MODE")

    (reply,) = ben.request(fresh(set_mode=CLOSED, issued_ns=issued_ns).SerializeToString())

    assert reply.reason == "not-fresh"
    assert sent_to(rig.board, "SET_MODE") == before


def test_a_wrong_clock_keeps_nobody_from_stop(rig: GuardedRig, ben: Client) -> None:
    before = sent_to(rig.board, "STOP")

    (reply,) = ben.request(fresh(stop=pb.Stop(), issued_ns=1).SerializeToString())

    assert reply.accepted
    assert sent_to(rig.board, "STOP") > before


def test_a_command_is_not_replayed_to_the_next_gateway(keys: SecurityFolder, tmp_path: Path) -> None:
    with guarded_rig(keys, tmp_path / "one") as rig, rig.join("ben") as ben:
        payload = fresh(set_mode=CLOSED).SerializeToString()
        assert ben.request(payload)[0].accepted
    with guarded_rig(keys, tmp_path / "two") as rig, rig.join("ben") as ben:
        (reply,) = ben.request(payload)

        assert reply.reason == "not-fresh"
        assert sent_to(rig.board, "SET_MODE") == 0


# -- too much, too large, nonsense


def test_a_flood_of_one_sender_takes_nothing_from_another(rig: GuardedRig, ana: Client, ben: Client) -> None:
    stop = threading.Event()
    refused: list[str] = []

    def flood() -> None:
        while not stop.is_set():
            handlers = [
                ben.session.get(ben.command_key, payload=payload, timeout=3.0)
                for payload in [fresh(ping=pb.Ping()).SerializeToString(), b"\xff"] * 100
            ]
            for handler in handlers:
                for reply in handler:
                    if reply.ok is not None:
                        answer = pb.CommandReply.FromString(reply.ok.payload.to_bytes())
                        refused.append(answer.reason)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        wait_for(lambda: refused.count("flood") > BURST, "refusals for flood")
        states = len(ana.states)

        # How fast: tests/bench/reactions.py.  The flood goes on until both are answered.
        (reply,) = ana.request(fresh(stop=pb.Stop()).SerializeToString(), timeout_s=HANG_S)
        (flooder_reply,) = ben.request(fresh(stop=pb.Stop()).SerializeToString(), timeout_s=HANG_S)
        (other,) = ana.request(fresh(ping=pb.Ping()).SerializeToString(), timeout_s=HANG_S)
    finally:
        stop.set()
        thread.join()

    assert reply.accepted
    assert flooder_reply.accepted  # STOP of the flooding sender, too
    assert other.accepted  # and more than STOP of another
    assert {"malformed", "flood"} <= set(refused)
    assert len(ana.states) > states
    event = wait_for(lambda: next((e for e in ana.events if e.name == "command-flood"), None), "event about the flood")
    assert "ben" in event.text
    wait_for(lambda: (r := ben.command(ping=pb.Ping())) is not None and r.accepted, "the end of the refusals")


@pytest.mark.parametrize("size", [5_000, LARGEST_COMMAND + 1, 1_000_000, LARGEST_MESSAGE + 1_000_000])
def test_an_oversize_payload_is_refused_or_goes_nowhere(rig: GuardedRig, ben: Client, size: int) -> None:
    replies = ben.request(b"\x0a" * size, timeout_s=3.0 if size < LARGEST_COMMAND else 1.0)

    assert [reply.reason for reply in replies] == (["oversize"] if size < LARGEST_COMMAND else [])


@pytest.mark.parametrize(
    "payload",
    [b"", b"\xff" * 40, b"\x0a\xff\xff\xff\xff\x0f", pb.Command(id="1").SerializeToString()],
    ids=["empty", "noise", "length beyond the end", "nothing to do"],
)
def test_a_malformed_message_is_refused_and_its_sender_logged(ben: Client, payload: bytes) -> None:
    before = len(ben.records)

    (reply,) = ben.request(payload)

    assert reply.refused_by == "gateway"
    assert reply.reason in ("malformed", "bad-id", "empty-command")
    wait_for(lambda: len(ben.records) > before, "record")
    assert ben.records[-1].command.who == "ben"


def test_random_bytes_in_every_key_change_nothing(rig: GuardedRig, ana: Client) -> None:
    keys = ("board51/rig/command/as/engineer/ana/more", "board51/rig/command/as", "board51/rig/command/as/engineer")
    for key in keys:
        assert ana.request(b"\x00\x01", key, timeout_s=1.0) == []


# -- the log


def test_the_log_says_who_did_what(keys: SecurityFolder, tmp_path: Path) -> None:
    with guarded_rig(keys, tmp_path) as rig, rig.join("ana") as ana, rig.join("vic") as vic:
        allowed, tried = fresh(set_mode=CLOSED, who="somebody"), fresh(set_mode=CLOSED, who="somebody")
        ana.request(allowed.SerializeToString())
        vic.request(tried.SerializeToString())
        ana.record_of(tried.id)

    records = {
        message.command.id: message
        for log in tmp_path.glob("*.mcap")
        for message in (m.message for m in read(log))
        if isinstance(message, pb.CommandRecord)
    }
    assert (records[allowed.id].command.who, records[allowed.id].command.role) == ("ana", "engineer")
    assert records[allowed.id].reply.accepted
    assert (records[tried.id].command.who, records[tried.id].command.role) == ("vic", "viewer")
    assert records[tried.id].reply.reason == "not-allowed"


def test_on_an_unguarded_bus_nobody_has_a_role() -> None:
    with ScriptedBoard() as board, gateway_and_client(gateway_config(board.url)) as bus:
        assert bus.request(pb.Command(id="1", who="eve", role="engineer", ping=pb.Ping()).SerializeToString()).accepted

        record = wait_for(lambda: bus.messages["rig/command/record"], "record")[0]
    assert (record.command.who, record.command.role) == ("eve", "")
