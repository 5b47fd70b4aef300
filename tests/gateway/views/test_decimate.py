"""Bins: every value lies in exactly one of them, whatever the order of taking."""

from __future__ import annotations

import math
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from gateway.views.decimate import Bin, Decimator


def push(decimator: Decimator, tick: int, *values: float, session: int = 1, lost: int = 0) -> None:
    decimator.push(values, session=session, tick=tick, t_s=tick * 2e-3, host_time_ns=tick * 2_000_000, lost=lost)


def test_a_spike_of_one_tick_is_in_the_bin_that_it_fell_into() -> None:
    decimator = Decimator(["x_m"], 10)

    for tick in range(30):
        push(decimator, tick, 9.0 if tick == 13 else 1.0)
    bins = decimator.take(unfinished=True)

    assert [(b.first_tick, b.last_tick) for b in bins] == [(0, 9), (10, 19), (20, 29)]
    assert [b.high["x_m"] for b in bins] == [1.0, 9.0, 1.0]
    assert [b.low["x_m"] for b in bins] == [1.0, 1.0, 1.0]
    assert bins[1].last["x_m"] == 1.0
    assert bins[1].host_time_ns == 19 * 2_000_000


@given(
    values=st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=1, max_size=60),
    gaps=st.lists(st.integers(1, 9), min_size=60, max_size=60),
    width=st.integers(1, 12),
    takes=st.sets(st.integers(0, 60)),
)
def test_no_value_is_lost_and_none_is_invented(
    values: list[float], gaps: list[int], width: int, takes: set[int]
) -> None:
    decimator, bins, tick = Decimator(["v"], width), list[Bin](), 0

    for n, value in enumerate(values):
        tick += gaps[n]
        push(decimator, tick, value)
        if n in takes:
            bins += decimator.take(unfinished=n % 2 == 0)
    bins += decimator.take(unfinished=True)

    finite = [v for v in values if not math.isnan(v)]
    extremes = [v for b in bins for v in (b.low["v"], b.high["v"]) if not math.isnan(v)]
    assert sum(b.samples for b in bins) == len(values)
    assert set(extremes) <= set(finite)
    assert (max(extremes, default=None), min(extremes, default=None)) == (
        max(finite, default=None),
        min(finite, default=None),
    )
    assert all(a.last_tick < b.first_tick for a, b in pairwise(bins))


def test_a_session_ends_its_bin() -> None:
    decimator = Decimator(["v"], 100)

    push(decimator, 40, 1.0, session=1)
    push(decimator, 41, 2.0, session=2, lost=3)
    bins = decimator.take(unfinished=True)

    assert [(b.session, b.high["v"], b.lost) for b in bins] == [(1, 1.0, 0), (2, 2.0, 3)]


def test_an_unread_decimator_keeps_the_newest_bins_and_counts_the_rest() -> None:
    decimator = Decimator(["v"], 1, keep=4)

    for tick in range(10):
        push(decimator, tick, float(tick))

    assert [b.first_tick for b in decimator.take()] == [5, 6, 7, 8]
    assert decimator.dropped == 5
