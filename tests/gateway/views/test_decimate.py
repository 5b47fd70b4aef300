"""Bins: every value lies in exactly one of them, whatever the order of taking."""

from __future__ import annotations

import math
import threading
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from gateway.views.decimate import MAX_BINS, Bin, TopicBins
from protocol.bus import board51_pb2 as pb


def bins_of(width: int) -> TopicBins:
    return TopicBins(pb.State, width, threading.Lock())


def push(tap: TopicBins, tick: int, x_m: float, session: int = 1, lost: int = 0) -> None:
    tap.push(pb.State(session=session, tick=tick, x_m=x_m, lost_before=lost))


def test_a_spike_of_one_tick_is_in_the_bin_that_it_fell_into() -> None:
    tap = bins_of(10)

    for tick in range(30):
        push(tap, tick, 9.0 if tick == 13 else 1.0)
    bins = tap.take(unfinished=True)

    assert [b.message.tick for b in bins] == [9, 19, 29]
    assert [b.high["x_m"] for b in bins] == [1.0, 9.0, 1.0]
    assert [b.low["x_m"] for b in bins] == [1.0, 1.0, 1.0]
    assert bins[1].last["x_m"] == 1.0


@given(
    values=st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=1, max_size=60),
    gaps=st.lists(st.integers(1, 9), min_size=60, max_size=60),
    width=st.integers(1, 12),
    takes=st.sets(st.integers(0, 60)),
)
def test_no_value_is_lost_and_none_is_invented(
    values: list[float], gaps: list[int], width: int, takes: set[int]
) -> None:
    tap, bins, tick = bins_of(width), list[Bin](), 0

    for n, value in enumerate(values):
        tick += gaps[n]
        push(tap, tick, value, lost=1)
        if n in takes:
            bins += tap.take(unfinished=n % 2 == 0)
    bins += tap.take(unfinished=True)

    finite = [v for v in values if not math.isnan(v)]
    extremes = [v for b in bins for v in (b.low["x_m"], b.high["x_m"]) if not math.isnan(v)]
    assert sum(b.lost for b in bins) == len(values)
    assert set(extremes) <= set(finite)
    assert (max(extremes, default=None), min(extremes, default=None)) == (
        max(finite, default=None),
        min(finite, default=None),
    )
    assert all(a.message.tick < b.message.tick for a, b in pairwise(bins))


def test_a_session_ends_its_bin() -> None:
    tap = bins_of(100)

    push(tap, 40, 1.0, session=1)
    push(tap, 41, 2.0, session=2, lost=3)
    bins = tap.take(unfinished=True)

    assert [(b.message.session, b.high["x_m"], b.lost) for b in bins] == [(1, 1.0, 0), (2, 2.0, 3)]


def test_of_bins_that_nobody_takes_the_newest_remain() -> None:
    tap = bins_of(1)

    for tick in range(MAX_BINS + 10):
        push(tap, tick, float(tick))

    assert [b.message.tick for b in tap.take()] == [*range(9, MAX_BINS + 9)]


def test_bins_have_the_channels_that_a_reader_wants() -> None:
    bins = TopicBins(pb.Divergence, 2, threading.Lock(), ("x_m.normalised", "nis_mean"))

    for tick, (normalised, nis_mean) in enumerate([(1.0, 2.0), (-3.0, 4.0), (0.0, 0.0)]):
        bins.push(
            pb.Divergence(tick=tick, session=1, x_m=pb.SignalDivergence(normalised=normalised), nis_mean=nis_mean)
        )

    (closed,) = bins.take()
    assert closed.low == {"x_m.normalised": -3.0, "nis_mean": 2.0}
    assert closed.high == {"x_m.normalised": 1.0, "nis_mean": 4.0}
    assert closed.last == {"x_m.normalised": -3.0, "nis_mean": 4.0}
