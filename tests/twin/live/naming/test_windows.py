"""Windows have uninterrupted flight alone, and a fast board fills no more of them than a slow one."""

from __future__ import annotations

import math

import pytest

from protocol.bus import board51_pb2 as pb
from twin.live.naming.windows import Window, Windows
from twin.mirror.output import IN_STEP, Output
from twin.mirror.sample import Sample
from twin.settings.naming import MAX_SAMPLES, WINDOW_S

NO_VALUES = (math.nan, math.nan, math.nan, math.nan, math.nan, False)


def output(tick: int, sample_time_s: float, *, valid: bool = True) -> Output:
    sample = Sample(tick, tick, 1, tick * sample_time_s, True, pb.MODE_CLOSED_LOOP, 0.6, 2e-3, 2.0, 2e-3, True)
    innovation = (0.0, 0.0, 2.0, 2.0, valid)
    answer = (innovation, (0.0, 0.0, 0.0, 0.0), NO_VALUES, NO_VALUES, NO_VALUES, False, (0, 0, 0))
    return Output(sample, IN_STEP, 0, True, answer, (), 0.0)


def cut(seconds: float, sample_time_s: float, invalid: tuple[int, ...] = ()) -> list[Window]:
    windows, complete = Windows(), []
    for tick in range(round(seconds / sample_time_s)):
        window = windows.take(
            output(tick, sample_time_s, valid=tick not in invalid),
            1000 + tick,
            sample_time_s=sample_time_s,
            i_lsb_a=1e-3,
            x_lsb_m=1e-6,
        )
        complete += [window] if window is not None else []
    return complete


@pytest.mark.parametrize(("sample_time_s", "samples"), [(2e-4, MAX_SAMPLES), (2e-3, MAX_SAMPLES), (2e-2, 165)])
def test_the_work_does_not_grow_with_the_sampling_rate(sample_time_s: float, samples: int) -> None:
    windows = cut(4.0 * WINDOW_S, sample_time_s)

    assert [len(window.readings) for window in windows] == [samples] * 4
    assert [window.from_s for window in windows] == pytest.approx([n * WINDOW_S for n in range(4)], abs=sample_time_s)


def test_no_window_has_a_sample_that_is_no_evidence() -> None:
    (window,) = cut(2.0 * WINDOW_S, 2e-3, invalid=(500, 1200))

    assert window.from_ns == 1000 + 1201
    assert window.from_s == pytest.approx(1201 * 2e-3)
    assert window.to_s == pytest.approx((1201 + MAX_SAMPLES - 1) * 2e-3)
