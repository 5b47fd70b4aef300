"""A capture changes u_c at its own instants; STATE shows u_c at the ticks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from protocol.campaign import Recording
from twin.readers.campaign import read_recording
from twin.readers.log import TwinLog

FIRST = 1000  # tick


@pytest.mark.parametrize(
    ("sample_time_s", "step_index", "count", "unknown"),
    [
        (40e-6, 100, 2000, []),  # the step is on tick 2, the end on tick 40
        (80e-6, 12, 240, [0, 9]),  # 0.48 ticks after its first tick, and 9.6
        (80e-6, 50, 240, [9]),
        (200e-6, 20, 205, [20]),
    ],
)
def test_an_input_that_changes_within_a_tick_is_not_known_there(
    tmp_path: Path, sample_time_s: float, step_index: int, count: int, unknown: list[int]
) -> None:
    parameters = pb.Parameters(session=1, sample_time_s=2e-3, i_lsb_a=5e-4, x_lsb_m=1e-6)
    capture = pb.CaptureRecord(
        session=1, tick=FIRST, sample_time_s=sample_time_s, u_from_v=0.0, u_to_v=2.0, step_index=step_index,
        i_c_a=[0.1] * count,
    )  # fmt: skip
    with TwinLog(tmp_path / "a.mcap") as log:
        log.write(key("board51", "rig", "parameters"), parameters, message_type=pb.Parameters, log_time_ns=1)
        for n in range(60):
            state = pb.State(session=1, tick=FIRST - 5 + n, t_s=2e-3 * n, u_c_v=2.0, i_c_a=0.1, x_m=0.0)
            log.write(key("board51", "rig", "state"), state, message_type=pb.State, log_time_ns=n + 2)
        log.write(key("board51", "rig", "capture"), capture, message_type=pb.CaptureRecord, log_time_ns=100)

    record = read_recording(tmp_path / "a.mcap", Recording(file="a.mcap", kind="amplifier-step", use="fit"))

    assert (np.flatnonzero(np.isnan(record.u_c)) - 5).tolist() == unknown
    assert not np.isnan(record.i_c).any()  # what was read at the tick is true
