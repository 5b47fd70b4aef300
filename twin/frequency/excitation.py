"""The parts of a flight under one excitation, found in the recorded reference alone.

Rule 1: a part is periodic if the reference repeats itself to half a count, at least three times.  The board's signals
        have periods of whole ticks, so its multisines, rectangles and sawteeth do.
Rule 2: what else moves (chirp, PRBS, steps of a hand) is a part without period.
Rule 3: the reference of a part stays within a third of the travel.  Over a larger swing there is no response to speak
        of: the plant's gain changes with the gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twin.estimation.record import BoolArray, FloatArray, runs

SHORTEST_PERIOD = 8  # samples: two more than a period needs to show more than its mean and two harmonics
LONGEST_PERIOD_S = 10.0
CHUNK_S = 120.0  # the search for a period takes the square of the length
SHORTEST_S = 3.0  # of a part
REPEATS = 3
MAX_SWING = 1 / 3  # of the travel


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Consecutive samples of a recording under one excitation."""

    samples: slice
    period: int  # samples; 0: not periodic


def parts(x_ref: FloatArray, usable: BoolArray, interval_s: float, travel_m: float, *, lsb: float) -> list[Part]:
    """Return the excited parts of a recording, in order.

    Args:
        x_ref: reference, m, shape (n,).
        usable: samples that belong to an uninterrupted flight, shape (n,).
        interval_s: sampling interval, s.
        travel_m: travel of the ball, m.
        lsb: one count of x_ref, m; 0: unknown.
    """
    result: list[Part] = []
    tolerance = max(0.5 * lsb, 1e-9 * travel_m)
    chunk, shortest = round(CHUNK_S / interval_s), round(SHORTEST_S / interval_s)
    for run in runs(usable, shortest):
        for start in range(run.start, run.stop, chunk):
            piece = slice(start, min(start + chunk, run.stop))
            result += _within(x_ref, piece, tolerance, shortest, round(LONGEST_PERIOD_S / interval_s))
    return [part for part in result if float(np.ptp(x_ref[part.samples])) <= MAX_SWING * travel_m]


def _within(x_ref: FloatArray, piece: slice, tolerance: float, shortest: int, longest_period: int) -> list[Part]:
    """The longest periodic part of a piece, and what is excited on both sides of it."""
    if piece.stop - piece.start < shortest:
        return []
    part = _periodic(x_ref, piece, tolerance, shortest, longest_period)
    if part is None:
        return list(_moving(x_ref, piece, tolerance, shortest))
    before, after = slice(piece.start, part.samples.start), slice(part.samples.stop, piece.stop)
    return [
        *_within(x_ref, before, tolerance, shortest, longest_period),
        part,
        *_within(x_ref, after, tolerance, shortest, longest_period),
    ]


def _periodic(x_ref: FloatArray, piece: slice, tolerance: float, shortest: int, longest_period: int) -> Part | None:
    r, best = x_ref[piece], None
    longest = shortest - 1
    changes = np.concatenate(([0], np.cumsum(np.abs(np.diff(r)) > tolerance)))
    for period in range(SHORTEST_PERIOD, min(len(r) // REPEATS, longest_period) + 1):
        # A stretch long enough has two neighbours of a coarse grid; most periods fail there, at little cost.
        needed = max(longest + 1, REPEATS * period) - period
        grid = np.arange(0, len(r) - period, max(needed // 2, 1))
        equal = np.abs(r[grid + period] - r[grid]) <= tolerance
        moving = changes[np.minimum(grid[1:] + period, len(r) - 1)] > changes[grid[:-1]]
        if not (equal[1:] & equal[:-1] & moving).any():
            continue
        # Differences, not an autocorrelation: one changed value ends a period, and a correlation would average it away.
        breaks = np.flatnonzero(np.abs(r[period:] - r[:-period]) > tolerance)
        ends = np.concatenate(([-1], breaks, [len(r) - period]))
        for k in np.flatnonzero(np.diff(ends) - 1 + period > longest):
            begin, length = int(ends[k]) + 1, int(ends[k + 1] - ends[k]) - 1 + period
            moves = float(np.ptp(r[begin : begin + period])) > 8.0 * tolerance
            # Strictly longer: multiples of a period fit as well, so the shortest is taken.
            if length >= REPEATS * period and length > longest and moves:
                longest = length
                best = Part(samples=slice(piece.start + begin, piece.start + begin + length), period=period)
    return best


def _moving(x_ref: FloatArray, piece: slice, tolerance: float, shortest: int) -> Iterator[Part]:
    # From the first change to the last: a constant reference at the ends excites nothing.
    changes = np.flatnonzero(np.abs(np.diff(x_ref[piece])) > tolerance)
    if len(changes) > 1 and changes[-1] - changes[0] >= shortest:
        yield Part(samples=slice(piece.start + int(changes[0]), piece.start + int(changes[-1]) + 1), period=0)
