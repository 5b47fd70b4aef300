"""Tests of the text that `board51 watch` prints of a message."""

from __future__ import annotations

import json

import pytest
from google.protobuf.message import Message

from gateway.commands import watch
from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import TOPICS


def test_the_mode_of_an_idle_board_is_on_its_line() -> None:
    state = pb.State(tick=7, mode=pb.MODE_IDLE)

    assert "mode=MODE_IDLE" in watch._line("board51/rig1/state", state, as_json=False)
    assert json.loads(watch._line("board51/rig1/state", state, as_json=True))["mode"] == "MODE_IDLE"


def test_a_quantity_that_was_not_measured_is_not_on_the_line() -> None:
    assert "i_c_a" not in watch._line("board51/rig1/state", pb.State(), as_json=False)
    assert "i_c_a=0" in watch._line("board51/rig1/state", pb.State(i_c_a=0.0), as_json=False)


@pytest.mark.parametrize("kind", dict.fromkeys(topic.message for topic in TOPICS), ids=lambda kind: kind.__name__)
def test_no_value_vanishes_because_it_is_zero(kind: type[Message]) -> None:
    printed = json.loads(watch._line("key", kind(), as_json=True))

    assert {field.name for field in kind.DESCRIPTOR.fields if not field.has_presence} <= set(printed)
