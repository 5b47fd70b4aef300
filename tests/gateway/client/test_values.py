"""Samples and captures that no gateway of this version sends."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.client.values import Sample, read_log
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError
from tests.harness.hostile_messages import write_log

NEWER = pb.State(session=3, tick=1)
NEWER.mode = 7  # type: ignore[assignment]  # as a newer gateway may send it
HUGE_TICK = pb.State(session=3, tick=1 << 63)


@pytest.mark.parametrize(("state", "named"), [(NEWER, "session 3 has the mode 7"), (HUGE_TICK, f"tick {1 << 63}")])
def test_a_sample_that_this_version_does_not_know_is_named_with_its_log(
    state: pb.State, named: str, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    write_log(path, [("state", pb.State(session=3)), ("state", state)])

    with pytest.raises(DataError, match=named):
        Sample.of(state)
    with pytest.raises(DataError, match=f"{path.name}: .*{named}"):
        read_log(path)
