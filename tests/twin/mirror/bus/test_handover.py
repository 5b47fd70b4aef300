"""Another model for a running twin, on a real bus: taken between two samples, or refused with the old one kept."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

import board51
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import zenoh_encoding
from tests.harness.ports import free_endpoint
from tests.harness.twin.rig import TRAVEL, G, M, Rig
from tests.harness.twin.twin_bus import Subscriber, introduce, publish, router, wait, wait_for_count
from twin.mirror.bus.handover import MAX_PAYLOAD, believe
from twin.mirror.bus.service import TwinService
from twin.mirror.bus.watched import REPEAT_S
from twin.model.parameters import Model
from twin.settings.mirror import Settings

HELD = 2.85e-3
OFFSET_M, SLOPE_A_PER_M = 2.4377e-3, 120.364
QUICK = Settings(window_s=0.25, false_alarms_per_day=0.1)
WINDOW = 125  # ticks of QUICK


def offset_rig(seed: int = 2) -> Rig:
    """A rig whose coil sits above the stop, flying."""
    rig = Rig(K_c=M * G / SLOPE_A_PER_M**2, gap_offset_m=OFFSET_M, seed=seed)
    rig.hold(HELD)
    return rig


def right_model() -> Model:
    """The model of that rig."""
    model = Model.load("ce152")
    parameters = dict(model.parameters)
    parameters["K_c"] = dataclasses.replace(parameters["K_c"], value=M * G / SLOPE_A_PER_M**2)
    plant = dataclasses.replace(model.plant, name="moved", x_max_m=TRAVEL + OFFSET_M)
    return dataclasses.replace(model, plant=plant, parameters=parameters)


def query(session: zenoh.Session, key: str, payload: bytes) -> dict[str, pb.CommandReply]:
    """Replies by key."""
    replies = session.get(
        key,
        payload=payload,
        encoding=zenoh_encoding(pb.TwinCommand),
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=15.0,
    )
    return {
        str(reply.ok.key_expr): pb.CommandReply.FromString(reply.ok.payload.to_bytes())
        for reply in replies
        if reply.ok is not None
    }


def answered(session: zenoh.Session, key: str, payload: bytes) -> dict[str, pb.CommandReply]:
    """`query`, again where nobody answers: a busy machine may lose a query of a megabyte, and an id counts once."""
    return query(session, key, payload) or query(session, key, payload)


def command(model: Model | str, *, number: str = "one", who: str = "me") -> bytes:
    text = model if isinstance(model, str) else believe(model).text
    return pb.TwinCommand(id=number, who=who, use_model=pb.UseModel(model_json=text)).SerializeToString()


def models(subscriber: Subscriber, board: str = "rig") -> list[pb.TwinModel]:
    return [pb.TwinModel.FromString(data) for data in subscriber.payloads[f"lab/{board}/twin/model"]]


def alarms(subscriber: Subscriber, board: str = "rig") -> list[pb.Alarm]:
    return [pb.Alarm.FromString(data) for data in subscriber.payloads[f"lab/{board}/twin/alarm"]]


def divergences(subscriber: Subscriber, board: str = "rig") -> list[pb.Divergence]:
    return [pb.Divergence.FromString(data) for data in subscriber.payloads[f"lab/{board}/twin/divergence"]]


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def test_the_right_model_ends_the_alarms_of_the_wrong_one_without_a_gap(endpoint: str) -> None:
    rig = offset_rig()
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,), settings=QUICK) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(1000, HELD)))
            wait_for_count(lambda: len(divergences(subscriber)), 1000, "divergence")
            before = alarms(subscriber)
            replies = query(session, "lab/rig/twin/command", command(right_model()))
            publish(session, list(rig.run(2000, HELD)))
            wait_for_count(lambda: len(divergences(subscriber)), 3000, "divergence")

    assert {alarm.name for alarm in before if alarm.active} == {"innovation", "divergence-i_c"}
    assert all("under the model ce152" in alarm.text for alarm in before if alarm.active)
    (reply,) = replies.values()
    assert (reply.accepted, reply.id, reply.tick) == (True, "one", 1000)
    ended = alarms(subscriber)[len(before) :]
    assert {alarm.name for alarm in ended} == {"innovation", "divergence-i_c"}
    assert not any(alarm.active for alarm in ended), "the right model raises nothing"
    assert all("another model" in alarm.text and alarm.host_time_ns > 10**18 for alarm in ended)
    received = divergences(subscriber)
    assert [message.tick for message in received] == list(range(3000))
    assert received[1000].sync == "settling"
    assert "out-of-step" not in {message.sync for message in received[1000:]}
    # Mean of 4 windows of chi-squares of 2 degrees, white: variance 4 each; 5 standard errors.
    last = [message.nis for message in received[-4 * WINDOW :]]
    assert abs(sum(last) / len(last) - 2.0) < 5 * 2.0 / math.sqrt(len(last))
    history = [(message.name, message.since_tick, message.who, message.command_id) for message in models(subscriber)]
    assert list(dict.fromkeys(history)) == [("ce152", 0, "", ""), ("moved", 1000, "me", "one")]
    assert json.loads(models(subscriber)[-1].model_json) == right_model().to_json()


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"\xff\xff", "malformed"),
        (b"", "bad-id"),
        (pb.TwinCommand(id="x").SerializeToString(), "empty-command"),
        (command("{}", who="a\nb"), "bad-who"),
        (command("", number="x" * 129), "bad-id"),
        (command("no json"), "bad-model"),
        (command("[" * 100_000, number="deep"), "bad-model"),
        (command("9" * 5000, number="long"), "bad-model"),
        (command(believe(Model.load("ce152")).text.replace("0.297", "1" + 400 * "0"), number="huge"), "bad-model"),
        (command(believe(Model.load("ce152")).text.replace("0.297", "NaN"), number="nan"), "bad-model"),
        (command(believe(Model.load("ce152")).text.replace("0.297", "297"), number="unit"), "bad-model"),
        (command(believe(Model.load("ce152")).text.replace('"ce152"', '"\\ud800"'), number="half"), "bad-model"),
        (command(believe(Model.load("ce152")).text.replace('"ce152"', '"a\\u001b[2J"'), number="screen"), "bad-model"),
        (command(" " * MAX_PAYLOAD), "oversize"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_model_is_refused_and_the_old_one_keeps_running(
    payload: bytes, reason: str, bus: tuple[zenoh.Session, TwinService, Rig]
) -> None:
    session, service, rig = bus
    before = service.boards["rig"]
    flown = before.samples

    (reply,) = answered(session, "lab/rig/twin/command", payload).values()
    publish(session, list(rig.run(20, HELD)))
    wait_for_count(lambda: before.samples, flown + 20, "samples")

    assert (reply.accepted, reply.refused_by, reply.reason) == (False, "twin", reason)
    assert reply.text.endswith(".")
    assert before.belief.model == Model.load("ce152")
    assert before.mirror.counters["models"] == 0
    assert service.running


@pytest.fixture(scope="module")
def bus() -> Iterator[tuple[zenoh.Session, TwinService, Rig]]:
    """A router with a twin of one flying board."""
    endpoint, rig = free_endpoint(), Rig(seed=2)
    rig.hold(HELD)
    with router(endpoint) as session, TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
        introduce(session, service, rig)
        publish(session, list(rig.run(300, HELD)))
        wait(lambda: "rig" in service.boards and service.boards["rig"].samples == 300, "samples")
        yield session, service, rig


def test_the_reason_of_a_refusal_names_key_and_value(bus: tuple[zenoh.Session, TwinService, Rig]) -> None:
    bad = believe(Model.load("ce152")).text.replace("0.297", "297")

    (reply,) = query(bus[0], "lab/rig/twin/command", command(bad, number="named")).values()

    assert "parameters.K_A.value = 297 is not in 0.001 .. 100" in reply.text


def test_the_same_id_is_executed_once(endpoint: str) -> None:
    rig = offset_rig()
    with router(endpoint) as session:
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(50, HELD)))
            wait(lambda: service.boards["rig"].samples == 50, "samples")
            key = "lab/rig/twin/command"
            first = query(session, key, command(right_model()))
            publish(session, list(rig.run(50, HELD)))
            wait(lambda: service.boards["rig"].samples == 100, "samples")
            again = query(session, key, command(right_model(), who="somebody else"))
            other = query(session, key, command(Model.load("ce152")))
            watched = service.boards["rig"]

            assert again == first
            assert first[key].tick == 50
            assert other[key].reason == "id-reused"
            assert watched.mirror.counters["models"] == 1
            assert watched.belief.model.plant.name == "moved"


def test_two_boards_of_one_twin_take_it_together_or_one_of_them(endpoint: str) -> None:
    everybody = "lab/*/twin/command"
    rigs = {"one": offset_rig(2), "two": offset_rig(3)}
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            early: dict[str, pb.CommandReply] = {}
            # The router may hear of the queryable a moment after the session is open.
            wait(
                lambda: bool(
                    early.update(query(session, everybody, command(Model.load("ce152"), number="early"))) or early
                ),
                "twin",
            )
            for name, rig in rigs.items():
                introduce(session, service, rig, board=name)
                publish(session, list(rig.run(30, HELD)), board=name)
            wait(lambda: all(item.samples == 30 for item in service.boards.values()), "samples of both")
            single = query(session, "lab/two/twin/command", command(right_model()))
            after_single = {name: item.belief.model.plant.name for name, item in service.boards.items()}
            unknown = query(session, "lab/three/twin/command", command(right_model()))
            both = query(session, everybody, command(right_model(), number="all"))
            introduce(session, service, offset_rig(4), board="late")
            for name, rig in rigs.items():
                publish(session, list(rig.run(30, HELD)), board=name)
            wait_for_count(lambda: len(divergences(subscriber, "two")), 60, "divergence")
            now = {name: item.belief.model.plant.name for name, item in service.boards.items()}

    assert {key: reply.accepted for key, reply in early.items()} == {everybody: True}
    assert set(single) == {"lab/two/twin/command"}
    assert after_single == {"one": "ce152", "two": "moved"}
    assert [(r.reason, "one, two" in r.text) for r in unknown.values()] == [("unknown-board", True)]
    assert {key: reply.accepted for key, reply in both.items()} == {f"lab/{n}/twin/command": True for n in rigs}
    assert now == dict.fromkeys(("one", "two", "late"), "moved")
    assert [item.tick for item in divergences(subscriber, "two")] == list(range(60))


@pytest.mark.slow
def test_the_model_is_told_again_for_those_who_come_later(endpoint: str) -> None:
    rig = offset_rig()
    with router(endpoint) as session:
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(10, HELD)))
            wait(lambda: service.boards["rig"].samples == 10, "samples")
            newcomer = Subscriber(session, "lab")
            wait(lambda: bool(models(newcomer)), "model", REPEAT_S + 10.0)

    assert models(newcomer)[0].sha256 == believe(Model.load("ce152")).sha256
    assert newcomer.encodings["lab/rig/twin/model"] == "application/protobuf;board51.v1.TwinModel"


def test_as_typed(endpoint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "moved.json"
    file.write_text(believe(right_model()).text)
    (tmp_path / "bad.json").write_text("{}")
    words = ["--connect", endpoint, "--site", "lab"]

    def call(*more: str) -> tuple[int, str, str]:
        code = board51.main(["twin", *more, *words])
        return code, *capsys.readouterr()

    rig = offset_rig()
    nobody = call("--hand-over", str(file))
    with router(endpoint) as session:
        no_twin = call("--hand-over", str(file))
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(20, HELD)))
            wait(lambda: service.boards["rig"].samples == 20, "samples")
            accepted = call("--hand-over", str(file), "--board", "rig", "--who", "me")
            as_json = call("--hand-over", "ce152", "--json")
            refused = call("--hand-over", str(file), "--board", "other")
            belief = service.boards["rig"].belief
    bad = call("--hand-over", str(tmp_path / "bad.json"))
    both = call("--hand-over", str(file), "--log", "x.mcap")

    assert (nobody[0], no_twin[0], accepted[0], as_json[0], refused[0], bad[0], both[0]) == (1, 1, 0, 0, 1, 2, 2)
    assert "No router answers" in nobody[2]
    assert "No twin answers for lab/*" in no_twin[2]
    assert accepted[1].startswith("lab/rig: runs on moved (")
    assert accepted[1].endswith("from tick 20\n")
    result = json.loads(as_json[1])
    assert [(row["board"], row["accepted"]) for row in result["twins"]] == [("rig", True)]
    assert belief.sha256 == result["sha256"]
    assert "unknown-board" in refused[1]
    assert "causes is missing" in bad[2]
    assert both[2].count("\n") == 1
