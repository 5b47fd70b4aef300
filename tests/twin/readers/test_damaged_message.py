"""A whole log with a message that is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocol.errors import DataError
from tests.harness.hostile_messages import write_payloads
from twin.readers.campaign import read_flight


@pytest.mark.parametrize("topic", ["state", "parameters", "capture"])
def test_a_message_that_cannot_be_read_is_named_with_its_log(topic: str, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_payloads(path, [(topic, b"\xff")])

    with pytest.raises(DataError, match=rf"log\.mcap: a message of board51/rig/{topic} at \d+ ns is damaged"):
        read_flight(path)
