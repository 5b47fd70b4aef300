"""A part of the samples, spread over all recordings: enough to find the start of a fit at a fraction of its cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.estimation.innovations import FOLLOWS
from twin.estimation.structures import EQUAL_NOISE
from twin.evidence.gather import Evidence
from twin.settings import diagnosis as settings

_GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # the golden ratio, less 1


def thinned(evidence: Evidence, share: float) -> Evidence:
    """The evidence with about this share of the blocks of its series, each a chain of its own.

    Which ones is decided by multiples of the golden ratio (H. Weyl, Mathematische Annalen 77, 1916): they are spread
    evenly, and no rhythm of the recordings coincides with theirs.
    """
    series = evidence.series
    begins = series.flags & FOLLOWS == 0
    elapsed_s = np.cumsum(series.step)
    elapsed_s -= np.maximum.accumulate(np.where(begins, elapsed_s, 0.0))
    # Blocks, not every n-th sample: a filter needs a chain, and a model with a delay the input before it.
    heads = begins | (np.diff(np.floor(elapsed_s / settings.THINNED_BLOCK_S + 1e-6), prepend=0.0) != 0.0)
    stays = np.cumsum(heads) * _GOLDEN % 1.0 < share
    flags = np.where(heads, series.flags & np.uint16(~FOLLOWS & 0xFFFF), series.flags)

    return replace(
        evidence,
        series=replace(series.part(stays), flags=flags[stays]),
        t=evidence.t[stays],
        noise_ratio=evidence.noise_ratio if evidence.noise_ratio is EQUAL_NOISE else evidence.noise_ratio[stays],
    )
