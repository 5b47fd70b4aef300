"""Part of the samples: whole blocks, spread over all recordings, each a chain of its own."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.harness.diagnose.simulated_rig import PLANT, THETA, narrow
from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X, Series
from twin.evidence.gather import Evidence, gather
from twin.evidence.thinned import thinned
from twin.settings import diagnosis as settings

STEP_S = 2e-3
BLOCK = round(settings.THINNED_BLOCK_S / STEP_S)


def series_of(chains: list[int]) -> Evidence:
    """Chains of so many samples, each in a recording of its own; u counts the samples."""
    n = sum(chains)
    flags = np.full(n, FOLLOWS | FLIES | USE_I | USE_X, np.uint16)
    flags[np.cumsum([0, *chains[:-1]])] &= np.uint16(~FOLLOWS & 0xFFFF)
    number = np.repeat(np.arange(len(chains), dtype=np.int32), chains)
    count = np.arange(n, dtype=np.float64)
    series = Series(step=np.full(n, STEP_S), u=count, i=count, x=count, flags=flags, recording=number)
    return Evidence(
        records=(), series=series, t=STEP_S * count, usages=(), statics=(), low_m=None, high_m=None, notes=(),
        noise_ratio=np.stack([1.0 + count, 2.0 + count], axis=1),
    )  # fmt: skip


@given(chains=st.lists(st.integers(1, 3000), min_size=1, max_size=12), share=st.floats(0.05, 0.9))
def test_blocks_stay_whole_and_begin_a_chain(chains: list[int], share: float) -> None:
    evidence = series_of(chains)

    part = thinned(evidence, share)

    begins = part.series.flags & FOLLOWS == 0
    jumps = np.diff(part.series.u, prepend=-9.0) != 1.0
    assert begins[jumps].all()  # no sample follows one that it did not follow
    stays = part.series.u.astype(int)
    first = np.concatenate([np.arange(length) for length in chains])[stays]
    assert (first[begins] % BLOCK == 0).all()
    assert not begins[first % BLOCK != 0].any()
    assert np.array_equal(part.series.recording, evidence.series.recording[stays])
    assert np.array_equal(part.t, evidence.t[stays])
    assert np.array_equal(part.noise_ratio, evidence.noise_ratio[stays])


@given(length=st.integers(40, 400), share=st.floats(0.1, 0.9), rhythm=st.integers(2, 9))
def test_they_are_spread_evenly_whatever_the_rhythm(length: int, share: float, rhythm: int) -> None:
    """Of blocks in a row, and of every second, third, ... block, the same share stays but for a few."""
    part = thinned(series_of([length * BLOCK]), share)

    blocks = np.unique(part.series.u.astype(int) // BLOCK)
    assert abs(len(blocks) - share * length) < 4.0
    beat = blocks[blocks % rhythm == 0]
    assert abs(len(beat) - share * len(range(0, length, rhythm))) < 6.0


def test_of_flights_too_short_for_a_block_some_stay() -> None:
    part = thinned(series_of([100] * 200), 0.25)

    assert abs(len(np.unique(part.series.recording)) - 50) < 4


def test_nothing_but_the_samples_changes() -> None:
    evidence = gather(narrow(THETA, seconds=2.0), PLANT)

    part = thinned(evidence, 0.5)

    assert part.records == evidence.records
    assert part.statics == evidence.statics
    assert 0 < len(part.series) < len(evidence.series)
