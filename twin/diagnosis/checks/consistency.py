"""Consistency of the recordings: contradictions between them, and effects that begin within one.

At the final model, score over information estimates by how much each stretch of data would move one parameter with the
others fixed.  Stretches that agree scatter about 0 with their own standard errors.

Rule 1: a contradiction is many standard errors large and of a size that matters.
Rule 2: a beginning is a point in time before which the cause is practically absent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twin.estimation.innovations import FOLLOWS, information
from twin.estimation.record import FloatArray
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.theta import parameter_of, unit_of
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """The move of one coordinate that one stretch of data supports."""

    recording: int
    t_s: float  # its beginning, on the recording's clock
    move: float  # of the coordinate, from the final model
    std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Beginning:
    """An effect that begins within a recording."""

    cause: str
    recording: str
    t_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Contradiction:
    """A recording that supports another value of a parameter than the rest."""

    recording: str
    parameter: str
    change: float  # relative


def stretches(criterion: Criterion, fit: Fit, names: Sequence[str]) -> dict[str, list[Stretch]]:
    """The moves of each coordinate, by blocks of about a second within recordings."""
    base, change = criterion.derivatives(fit.theta, names)
    series = criterion.evidence.series
    t = criterion.evidence.t
    result: dict[str, list[Stretch]] = {name: [] for name in names}
    for block in _blocks(series.recording, series.flags, series.step):
        n = block.stop - block.start
        fisher, each = np.zeros((len(names), len(names))), np.empty((n, len(names)))
        information(base[block], np.ascontiguousarray(change[:, block]), each, fisher)
        for index, name in enumerate(names):
            # Each coordinate alone, the others held: a joint fit of each block would need more data than a second has.
            information_sum = float(fisher[index, index])
            if information_sum > 1e-12:
                result[name].append(
                    Stretch(
                        recording=int(series.recording[block.start]),
                        t_s=float(t[block.start]),
                        move=float(each[:, index].sum()) / information_sum,
                        std=1.0 / math.sqrt(information_sum),
                    )
                )
    return result


def contradictions(criterion: Criterion, fit: Fit) -> list[Contradiction]:
    """Return the recordings that support another K_A or K_c than the rest."""
    names = tuple(settings.DRIFT)
    moves = stretches(criterion, fit, names)
    result = []
    for name, min_change in settings.DRIFT.items():
        for number, recording in enumerate(criterion.evidence.names()):
            of_recording = [stretch for stretch in moves[name] if stretch.recording == number]
            if not of_recording:
                continue
            weights = np.array([stretch.std**-2 for stretch in of_recording])
            # The mean by information: stretches in which the ball hardly moves say little and would scatter most.
            move = float(np.sum(weights * [stretch.move for stretch in of_recording]) / weights.sum())
            # Large and significant: alone, a long recording makes a drift of a thousandth significant.
            if abs(move) > min_change and abs(move) * math.sqrt(float(weights.sum())) > settings.DRIFT_ERRORS:
                result.append(Contradiction(recording=recording, parameter=name, change=math.expm1(move)))
    return result


def beginnings(criterion: Criterion, fit: Fit, causes: Sequence[str]) -> list[Beginning]:
    """Return the causes that are absent at first, with the time at which they begin."""
    names = [f"{cause}.{BY_NAME[cause].strength.name}" for cause in causes]
    if not names:
        return []
    moves = stretches(criterion, fit, names)
    result = []
    for cause, name in zip(causes, names, strict=True):
        parameter = parameter_of(name)
        strength = parameter.coordinate(fit.theta.value(name)) / unit_of(parameter)
        moves_of_cause = moves[name]
        if len(moves_of_cause) < 4 or strength == 0.0:
            continue
        weights = np.array([stretch.std**-2 for stretch in moves_of_cause])
        strengths = strength + np.array([stretch.move for stretch in moves_of_cause])
        # One change of the mean by least squares (Hinkley, 1970), not a running test: the question is asked once,
        # afterwards.
        index, gain, before, after = _split(strengths, weights)
        # Absent before, and not only weaker: a strength that drifts is no beginning.
        is_absent_before = abs(before) < settings.BEGINNING_ABSENT * abs(after) and after * strength > 0.0
        is_significant = abs(after) * math.sqrt(float(weights[index:].sum())) > settings.BEGINNING_Z
        if gain > settings.BEGINNING_GAIN and is_absent_before and is_significant:
            stretch = moves_of_cause[index]
            recording = criterion.evidence.names()[stretch.recording]
            result.append(Beginning(cause=cause, recording=recording, t_s=stretch.t_s))
    return result


def _split(values: FloatArray, weights: FloatArray) -> tuple[int, float, float, float]:
    """Return (first block after the best split, gain of log-likelihood, weighted mean before, after)."""
    total_w, total = weights.cumsum(), (weights * values).cumsum()
    best = (1, -math.inf, 0.0, 0.0)
    for index in range(1, len(values)):
        w_1, w_2 = total_w[index - 1], total_w[-1] - total_w[index - 1]
        if w_1 <= 0.0 or w_2 <= 0.0:
            continue
        first, second = total[index - 1] / w_1, (total[-1] - total[index - 1]) / w_2
        # The likelihood ratio of two means over one (D. V. Hinkley, Biometrika 57(1), 1970).
        gain = 0.5 * w_1 * w_2 / (w_1 + w_2) * (first - second) ** 2
        if gain > best[1]:
            best = (index, float(gain), float(first), float(second))
    return best


def _blocks(
    recording: np.ndarray[tuple[int], np.dtype[np.int32]],
    flags: np.ndarray[tuple[int], np.dtype[np.uint16]],
    step: FloatArray,
) -> list[slice]:
    """Return the pieces of about `DRIFT_BLOCK_S`, never across recordings or gaps."""
    edges = np.flatnonzero((flags & FOLLOWS == 0) | np.append(True, np.diff(recording) != 0))
    pieces = []
    for a, b in zip(edges, np.append(edges[1:], len(flags)), strict=True):
        if b - a < 20:
            continue
        duration_s = float(step[a + 1 : b].sum())
        count = max(round(duration_s / settings.DRIFT_BLOCK_S), 1)
        cuts = np.linspace(a, b, count + 1).astype(int)
        pieces += [slice(int(c), int(d)) for c, d in pairwise(cuts) if d > c]
    return pieces
