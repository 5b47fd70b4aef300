"""The cause `lost-samples`: counted from the gaps in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.distributions import Z_95
from twin.estimation.record import Record
from twin.model.causes.catalogue import cause_of_detector
from twin.settings import diagnosis as settings

CAUSE = cause_of_detector("gaps")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lost:
    """The rate of lost samples."""

    probability: float  # that a sample is lost
    ci95: tuple[float, float]
    worst: str  # the recording with most lost samples


def lost_samples(records: Sequence[Record]) -> Lost | None:
    """The rate of lost samples with Wilson's interval; None if there are only a few interruptions."""
    missing, total, gaps, worst = 0, 0, 0, ("", 0)
    for record in records:
        if record.kind == "equilibria" or len(record.t) < 100:
            continue
        steps = np.diff(record.t)
        interval = record.interval_s
        whole = np.rint(steps / interval)
        if np.mean(np.abs(steps / interval - whole) < 0.1) < 0.99:
            continue  # sampled at varying times: gaps are not recognised
        lost = whole[(whole > 1) & (whole <= settings.LONGEST_GAP)] - 1
        missing, gaps, total = missing + int(lost.sum()), gaps + len(lost), total + len(record.t)
        if lost.sum() > worst[1]:
            worst = (record.name, int(lost.sum()))
    if gaps < settings.MIN_GAPS or missing < settings.MIN_MISSING * total:
        return None
    n = missing + total
    p, z = missing / n, Z_95
    # E. B. Wilson, Journal of the American Statistical Association 22(158), 1927.  The usual p +- z sqrt(p (1 - p) / n)
    # is empty at 0 and may be negative.
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return Lost(probability=p, ci95=(middle - half, middle + half), worst=worst[0])
