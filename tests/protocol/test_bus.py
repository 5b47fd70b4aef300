"""Tests of the messages on the bus: keys, encodings, generated classes, and decoding without them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import cast

import pytest
from google.protobuf import json_format, message_factory
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from hypothesis import given
from hypothesis import strategies as st

from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding, topics
from protocol.bus.topics import TOPICS, Topic
from protocol.errors import Board51Error, ConfigError
from protocol.wire import messages

ROOT = Path(__file__).parents[2]
PROTO = "protocol/bus/board51.proto"


def fields_of(message: type[Message]) -> list[FieldDescriptor]:
    return cast("list[FieldDescriptor]", list(message.DESCRIPTOR.fields))


def example(message: type[Message]) -> Message:
    """A message with every plain field set, one level deep, to a value that its type can hold."""
    filled = message()
    for number, field in enumerate(fields_of(message), start=1):
        if field.type == FieldDescriptor.TYPE_MESSAGE:
            continue
        if field.is_repeated:
            texts = field.type == FieldDescriptor.TYPE_STRING
            getattr(filled, field.name).extend(["one", "two"] if texts else [0.5, number])
            continue
        value: object = number
        if field.type == FieldDescriptor.TYPE_DOUBLE:
            value = number + 0.25
        elif field.type == FieldDescriptor.TYPE_STRING:
            value = field.name
        elif field.type == FieldDescriptor.TYPE_BYTES:
            value = field.name.encode()
        elif field.type == FieldDescriptor.TYPE_BOOL:
            value = True
        elif field.type == FieldDescriptor.TYPE_ENUM:
            value = 1
        setattr(filled, field.name, value)
    return filled


def test_the_generated_classes_are_those_of_the_proto_file(tmp_path: Path) -> None:
    command = ["-m", "grpc_tools.protoc", "-I.", f"--python_out={tmp_path}", f"--pyi_out={tmp_path}", PROTO]

    subprocess.run([sys.executable, *command], cwd=ROOT, check=True, timeout=60)

    for name in ("board51_pb2.py", "board51_pb2.pyi"):
        fresh = (tmp_path / "protocol/bus" / name).read_text(encoding="utf-8")
        assert (ROOT / "protocol/bus" / name).read_text(encoding="utf-8") == fresh, (
            f"run: python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. {PROTO}"
        )


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_log_is_read_with_nothing_but_its_descriptor_set(topic: Topic) -> None:
    sent = example(topic.message)
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(encoding.descriptor_set()).file:
        pool.Add(file)
    stranger = message_factory.GetMessageClass(pool.FindMessageTypeByName(encoding.schema_name(topic.message)))

    read = stranger.FromString(sent.SerializeToString())

    assert not isinstance(read, topic.message)
    assert json_format.MessageToDict(read) == json_format.MessageToDict(sent)


def test_the_descriptor_set_is_complete_and_always_the_same() -> None:
    files = FileDescriptorSet.FromString(encoding.descriptor_set())

    assert [dependency for file in files.file for dependency in file.dependency] == []
    assert encoding.descriptor_set() == encoding.descriptor_set()


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_parsing_gives_back_what_was_sent(topic: Topic) -> None:
    sent = example(topic.message)

    assert encoding.parse(topic.message, sent.SerializeToString()) == sent


@pytest.mark.parametrize("data", [b"\xff", b"\x08", b"\x0a\x05ab", b"\x00" * 8, b"not a message", b"\x39\x01\x02"])
def test_parsing_junk_gives_none(data: bytes) -> None:
    assert encoding.parse(pb.State, data) is None


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
@given(data=st.binary(max_size=64))
def test_parsing_never_raises(topic: Topic, data: bytes) -> None:
    parsed = encoding.parse(topic.message, data)

    assert parsed is None or isinstance(parsed, topic.message)


def test_zero_is_a_value_and_absence_is_not_zero() -> None:
    state = encoding.parse(pb.State, pb.State(x_m=0.0).SerializeToString())

    assert state is not None
    assert state.HasField("x_m")
    assert not state.HasField("i_c_a")


def test_names_under_which_messages_are_known() -> None:
    assert encoding.schema_name(pb.State) == "board51.v1.State"
    assert encoding.zenoh_encoding(pb.TwinState) == "application/protobuf;board51.v1.TwinState"


def test_codes_on_the_bus_are_those_on_the_line() -> None:
    assert dict(pb.Mode.items()) == {f"MODE_{mode.name}": mode.value for mode in messages.Mode}
    assert dict(pb.Law.items()) == {f"LAW_{law.name}": law.value for law in messages.Law}
    assert dict(pb.Shape.items()) == {f"SHAPE_{shape.name}": shape.value for shape in messages.Shape}


@pytest.mark.parametrize("topic", [*topics.TOPIC_OF_NAME, topics.ALIVE])
def test_keys_are_made_and_taken_apart(topic: str) -> None:
    key = topics.key("lab", "rig-1", topic)

    assert key == f"lab/rig-1/{topic}"
    assert topics.split(key) == (None if topic == topics.ALIVE else ("lab", "rig-1", topic))


@pytest.mark.parametrize(
    "key", ["", "state", "lab/state", "lab/rig/", "lab/rig/stated", "/lab/rig/state", "lab/rig/twin"]
)
def test_foreign_keys_are_not_ours(key: str) -> None:
    assert topics.split(key) is None


def test_a_key_of_no_topic_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="'speed' is not a topic"):
        topics.key("lab", "rig", "speed")


@pytest.mark.parametrize("name", ["", "a/b", "*", "Rig", "rig 1", "-rig", "r" * 33, "rig\n", "ríg"])
def test_a_name_that_could_not_be_a_key_chunk_is_refused_with_what_to_do(name: str) -> None:
    with pytest.raises(ConfigError, match=r"board name .* is not a name") as refused:
        topics.check_name(name, what="board name")

    assert "letters, digits" in refused.value.remedy
    assert isinstance(refused.value, Board51Error)
    assert refused.value.exit_code == 2


@pytest.mark.parametrize("name", ["a", "rig-1", "0_x", "r" * 32])
def test_a_good_name_is_returned(name: str) -> None:
    assert topics.check_name(name, what="site") == name


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_units_end_the_names_of_fields_with_a_dimension(topic: Topic) -> None:
    """A double without a unit at its end must be one that has none."""
    units = ("_a", "_v", "_m", "_s", "_ms", "_m_s", "_per_s")
    plain = {"gains", "line_load", "nis", "nis_mean", "nis_on", "value", "probability", "threshold_on", "threshold_off"}

    for field in fields_of(topic.message):
        if field.type == FieldDescriptor.TYPE_DOUBLE:
            assert field.name.endswith(units) or field.name in plain, field.name
