"""The board's clock beside that of the computer, by the times at which samples arrived."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from protocol.campaign import Recording
from twin.readers.campaign import read_recording
from twin.readers.host_clock import MIN_STD, clock_error, combined
from twin.readers.log import TwinLog

TICK_S = 2e-3


def arrivals(share: float, seconds: float, *, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Board times of a clock that is slow by `share`, and arrivals: most soon, some 50 ms late."""
    rng = np.random.default_rng(seed)
    t = TICK_S * np.arange(round(seconds / TICK_S))
    delay = 1e-3 + rng.exponential(2e-3, len(t)) + 0.05 * (rng.random(len(t)) < 0.01)
    return t, (1.0 + share) * t + delay


@pytest.mark.parametrize("share", [0.0, 0.02, -0.02, 0.002])
def test_the_error_of_a_clock_is_measured_whatever_the_delays(share: float) -> None:
    error = clock_error(*arrivals(share, 20.0))

    assert error is not None
    assert error[0] == pytest.approx(share, abs=2e-4)
    assert MIN_STD <= error[1] < 1e-3


def test_a_short_session_measures_nothing_and_neither_does_a_board_out_of_real_time() -> None:
    assert clock_error(*arrivals(0.0, 5.0)) is None
    assert clock_error(*arrivals(4.0, 20.0)) is None
    assert combined([None, None]) is None


def test_sessions_do_not_make_the_computers_clock_better() -> None:
    mean = combined([(0.02, 5e-4), None, (0.018, 1e-3)])

    assert mean is not None
    assert mean[0] == pytest.approx(0.0196, abs=1e-4)
    assert mean[1] == 5e-4


@pytest.mark.parametrize(("share", "notes"), [(0.0, 0), (0.02, 1)])
def test_a_log_has_the_error_of_the_clock_and_says_so_if_it_is_large(tmp_path: Path, share: float, notes: int) -> None:
    t, host_s = arrivals(share, 12.0)
    with TwinLog(tmp_path / "a.mcap") as log:
        for n, (t_s, at_s) in enumerate(zip(t.tolist(), host_s.tolist(), strict=True)):
            state = pb.State(session=1, tick=n, t_s=t_s, host_time_ns=10**18 + round(at_s * 1e9), i_c_a=0.1, x_m=0.0)
            log.write(key("board51", "rig", "state"), state, message_type=pb.State, log_time_ns=n)

    record = read_recording(tmp_path / "a.mcap", Recording(file="a.mcap", kind="closed-loop", use="fit"))

    assert record.clock_error is not None
    assert record.clock_error[0] == pytest.approx(share, abs=3e-4)
    assert len(record.notes) == notes
    assert all("the board's clock is 2 % slow by the computer's" in note for note in record.notes)
