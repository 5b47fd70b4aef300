"""A real log for Foxglove: its Log and 3D panels, and layouts whose every path is there."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

import board51
from gateway.commands.views.foxglove import layout
from gateway.emulator.serve import Emulator
from gateway.record.replay import DEFAULT_TOPICS, contents
from gateway.views.foxglove.derived import line_of
from gateway.views.foxglove.scene import PERIOD_NS, Scene, timestamp_of
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import plant_message
from protocol.log.reader import LogReader
from protocol.plant import Plant
from tests.harness.gateway.gateway_peers import gateway_and_client, gateway_config

Messages = dict[str, list[tuple[int, Any]]]  # by topic: log time and message


def decoded(path: Path) -> Messages:
    """All messages of a file, by a reader that knows nothing but the file."""
    classes: dict[int, Any] = {}
    messages: Messages = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if schema.id not in classes:
                pool = descriptor_pool.DescriptorPool()
                for part in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(part)
                classes[schema.id] = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            parsed = classes[schema.id].FromString(message.data)
            messages.setdefault(channel.topic, []).append((message.log_time, parsed))
    return messages


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`run.mcap` of a gateway with a refused command, `twin.mcap` of the twin over it, and what is shown of both."""
    path: Path = tmp_path_factory.mktemp("logs")
    with Emulator(tcp=False) as emulator, gateway_and_client(gateway_config(*emulator.urls, log=path)) as bus:
        bus.command("mode", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP))
        assert not bus.command("high", set_reference=pb.SetReference(x_ref_m=1.0)).accepted
        bus.await_states(600)
    (log,) = path.glob("*.mcap")
    log.rename(path / "run.mcap")
    assert board51.main(["twin", "--log", str(path / "run.mcap"), "--out", str(path / "twin.mcap")]) == 0
    for name in ("run", "twin"):
        words = ["foxglove", str(path / f"{name}.mcap"), "-o", str(path / f"shown-{name}.mcap")]
        assert board51.main(words) == 0
    return path


@pytest.fixture(scope="module")
def log_messages(folder: Path) -> Messages:
    return decoded(folder / "shown-twin.mcap") | decoded(folder / "shown-run.mcap")


def test_events_and_refused_commands_are_lines(log_messages: Messages) -> None:
    lines = [(line.name, line.level, line.message) for _, line in log_messages["board51/rig/log"]]

    refusals = [message for name, level, message in lines if name == "command"]
    assert len(refusals) == 1
    assert refusals[0].startswith("set-reference by ")
    assert "out-of-range" in refusals[0]
    assert any(name == "board" and "mode-changed" in message for name, _, message in lines)
    assert [line.timestamp.ToNanoseconds() for _, line in log_messages["board51/rig/log"]] == [
        time_ns for time_ns, _ in log_messages["board51/rig/log"]
    ]


def test_the_scene_has_both_balls_where_they_were(folder: Path) -> None:
    twin = decoded(folder / "shown-twin.mcap")
    scenes = twin["board51/rig/scene"]
    states = dict(reversed(twin["board51/rig/state"]))  # of samples that arrived at once the first is shown

    span_ns = scenes[-1][0] - scenes[0][0]
    assert len(scenes) == pytest.approx(span_ns / PERIOD_NS, abs=2)
    time_ns, last = scenes[-1]
    entities = {entity.id: entity for entity in last.entities}
    assert set(entities) == {"coil", "ball", "twin"}
    ball = entities["ball"].spheres[0]
    assert ball.size.x == pytest.approx(12.63e-3, abs=1e-5)  # a steel ball of 8.28 g
    assert ball.pose.position.z == pytest.approx(states[time_ns].x_m + ball.size.x / 2)
    assert entities["twin"].spheres[0].color.a < 0.5 < ball.color.a


def test_a_replay_and_a_second_copy_have_nothing_twice(folder: Path, tmp_path: Path) -> None:
    reader = LogReader(folder / "shown-run.mcap")

    replayed = contents(reader, topics_=DEFAULT_TOPICS, boards=None)
    assert board51.main(["foxglove", str(folder / "shown-run.mcap"), "-o", str(tmp_path / "again.mcap")]) == 0

    assert not {topic for _, _, topic in replayed} & {"log", "scene"}
    counts = [{topic: len(rows) for topic, rows in decoded(path).items()} for path in
              (folder / "shown-run.mcap", tmp_path / "again.mcap")]  # fmt: skip
    assert counts[0] == counts[1]


def test_the_samples_are_those_of_the_log(folder: Path) -> None:
    both = [list(LogReader(folder / name).raw()) for name in ("run.mcap", "shown-run.mcap")]

    assert both[0] == both[1]


@pytest.mark.parametrize("words", [["LOG"], ["-o", "out.mcap"]])
def test_a_log_without_a_destination_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["foxglove", *words]) == 2
    assert "LOG and -o go together" in capsys.readouterr().err


def test_an_alarm_is_a_line_when_it_is_raised_and_when_it_is_over() -> None:
    raised = line_of(pb.Alarm(name="divergence-x", active=True, text="too far"), 5)
    over = line_of(pb.Alarm(name="divergence-x", text="near again"), 6)

    assert "alarm divergence-x raised: too far" in repr(raised)
    assert "alarm divergence-x over: near again" in repr(over)
    assert line_of(pb.Alarms(active=[pb.Alarm(name="link-down", active=True)]), 7) is None  # it repeats itself


def test_a_time_that_foxglove_cannot_express_is_its_latest() -> None:
    never_ns = (1 << 64) - 1  # in the year 2554

    assert timestamp_of(never_ns).sec == (1 << 32) - 1
    assert line_of(pb.Event(severity="info", name="x"), never_ns) is not None
    assert Scene("rig").take(pb.State(x_m=1e-3), never_ns) is not None


def test_the_card_gives_the_size_of_ball_and_travel() -> None:
    plant = Plant(name="own", mass_kg=2e-3, travel_m=8e-3, x_max_m=9e-3, gravity_m_s2=9.81, ball_diameter_m=8e-3)
    scene = Scene("rig")

    scene.take(pb.PlantCard(plant=plant_message(plant)), 0)
    update = repr(scene.take(pb.State(session=1, x_m=1e-3), 1))

    assert "ball 8 mm, travel 8 mm" in update
    assert "assumed" not in update
    assert "assumed" in repr(Scene("rig").take(pb.State(session=1), 1))


def expect_path(log_messages: Messages, topic: str, fields: list[str]) -> None:
    assert topic in log_messages, topic
    message = log_messages[topic][0][1]
    for name in fields:
        assert name in message.DESCRIPTOR.fields_by_name, (topic, fields)
        message = getattr(message, name)


def foxglove_paths(made: Any) -> Iterator[tuple[str, list[str]]]:
    for path in re.findall(r'\\"([^"\\]+)\\"((?:\.\w+)*)', json.dumps(made)):
        yield path[0], path[1].split(".")[1:]
    for panel in made["configById"].values():
        yield from ((topic, []) for topic in panel.get("topics", ()))
        yield from ((panel[key], []) for key in ("topicToRender",) if key in panel)


def test_every_path_of_the_foxglove_layout_is_in_the_log(log_messages: Messages) -> None:
    made = json.loads(layout("foxglove", "board51", "rig"))

    paths = list(foxglove_paths(made))
    for topic, fields in paths:
        expect_path(log_messages, topic, fields)

    assert {topic.rpartition("/")[2] for topic, _ in paths} >= {"log", "scene", "state", "divergence"}
    panels = re.findall(r'"([A-Za-z0-9]+!\w+)"', json.dumps(made["layout"]))
    assert set(panels) == set(made["configById"])
    scene = log_messages["board51/rig/scene"][0][1]
    assert {entity.frame_id for entity in scene.entities} == {made["configById"]["3D!scene"]["followTf"]}


def test_every_curve_of_the_plotjuggler_layout_is_in_the_log(log_messages: Messages) -> None:
    curves = [c.attrib["name"] for c in ElementTree.fromstring(layout("plotjuggler", "board51", "rig")).iter("curve")]

    assert len(curves) > 12
    for curve in curves:
        topic = max((topic for topic in log_messages if curve.startswith(f"{topic}/")), key=len)
        expect_path(log_messages, topic, curve.removeprefix(f"{topic}/").split("/"))
