"""Errors 20 ms ahead, grouped by position, speed, current, direction, time after a step, time, recording."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from twin.diagnosis.residuals.force import Filtered
from twin.diagnosis.residuals.regimes import (
    Bin,
    Blocks,
    Labels,
    Regime,
    bin_labels,
    error_bins,
    even_edges,
    quantile_edges,
)
from twin.estimation.innovations import LOST
from twin.estimation.record import FloatArray
from twin.estimation.step_figures import changes
from twin.evidence.gather import Evidence
from twin.model.extended import V

_GROUPS = 8
_SPEED_SHARES = (0.0, 0.03, 0.12, 0.3, 0.5, 0.7, 0.88, 0.97, 1.0)
_AFTER_STEP_S = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1e9)
_TIMES = 12


def sorted_errors(errors_m: FloatArray, evidence: Evidence, model: Filtered, blocks: Blocks) -> tuple[Regime, ...]:
    """The errors by regime; a regime with a single group is left out.

    Args:
        errors_m: x_hat - x of every sample, baseline and extended, shape (2, n), NaN without a prediction.
        evidence: the recordings.
        model: the extended model along them, for the speed.
        blocks: bootstrap blocks of the samples.
    """
    s = evidence.series
    known = np.isfinite(errors_m).all(axis=0)
    x, v, i = (np.where(known, values, np.nan) for values in (s.x, model.state[:, V], s.i))
    t = _campaign_time(evidence)
    elapsed = np.where(known, t, np.nan)
    regimes = [
        _numeric("position", "position x", "m", x, even_edges(x, _GROUPS), errors_m, blocks),
        # By quantiles: in a closed loop the speed is mostly near 0, and even groups would leave the outer ones empty.
        _numeric("speed", "speed x'", "m/s", v, quantile_edges(v, _SPEED_SHARES), errors_m, blocks),
        _numeric("current", "current i_c", "A", i, even_edges(i, _GROUPS), errors_m, blocks),
        _named("direction", "direction of motion", *_direction(v), errors_m, blocks),
        _named("after-step", "time after a reference step", *_after_steps(evidence), errors_m, blocks),
        _numeric("time", "time over the recordings", "s", elapsed, even_edges(elapsed, _TIMES), errors_m, blocks),
        _named(
            "recording",
            "recording",
            s.recording.astype(np.int64),
            [record.name for record in evidence.records],
            errors_m,
            blocks,
        ),
    ]
    return tuple(regime for regime in regimes if len(regime.bins) > 1)


def _numeric(
    name: str, title: str, unit: str, values: FloatArray, edges: FloatArray, errors_m: FloatArray, blocks: Blocks
) -> Regime:
    bins: list[Bin] = []
    if len(edges) > 1:
        factor, scaled_unit = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s")}.get(unit, (1.0, unit))
        names = [f"{a * factor:.3g} to {b * factor:.3g} {scaled_unit}" for a, b in pairwise(edges)]
        bins = error_bins(errors_m, bin_labels(values, edges), names, values, blocks)
    return Regime(name=name, title=title, unit=unit, bins=tuple(bins))


def _named(name: str, title: str, labels: Labels, names: Sequence[str], errors_m: FloatArray, blocks: Blocks) -> Regime:
    at = np.zeros(len(labels))
    return Regime(name=name, title=title, unit="", bins=tuple(error_bins(errors_m, labels, names, at, blocks)))


def _direction(v: FloatArray) -> tuple[Labels, list[str]]:
    """Return the labels sinking, slow, rising; the slower half of the samples is slow."""
    known = np.isfinite(v)
    # Half of the samples count as slow: the sign of a speed near 0 is noise.
    slow = float(np.median(np.abs(v[known]))) if known.any() else 0.0
    labels = np.where(known, np.where(v < -slow, 0, np.where(v > slow, 2, 1)), -1).astype(np.int64)
    return labels, ["sinking", f"slower than {slow * 1e3:.2g} mm/s", "rising"]


def _after_steps(evidence: Evidence) -> tuple[Labels, list[str]]:
    """Return the labels by the time since the reference began to change from one level to another."""
    s = evidence.series
    since = np.full(len(s), np.nan)
    for number, record in enumerate(evidence.records):
        n = len(record.t)
        rows = np.flatnonzero((s.recording == number) & (s.flags & LOST == 0))[:n]
        if record.kind != "closed-loop" or len(rows) < n or not record.has("x_ref"):
            continue
        for before, after in changes(record.x_ref, record.interval_s):
            part = slice(before.stop, after.stop)
            since[rows[part]] = record.t[part] - record.t[before.stop]
    edges = np.array(_AFTER_STEP_S)
    names = [f"{a * 1e3:.0f} to {b * 1e3:.0f} ms" for a, b in pairwise(edges[:-1])]
    return bin_labels(since, edges), [*names, f"later than {edges[-2] * 1e3:.0f} ms"]


def _campaign_time(evidence: Evidence) -> FloatArray:
    """Return the time of each sample with the recordings one after the other in the campaign's order, s, shape (n,)."""
    t, begins = np.full(len(evidence.series), np.nan), 0.0
    for number in range(len(evidence.records)):
        rows = np.flatnonzero(evidence.series.recording == number)
        if len(rows):
            elapsed = evidence.t[rows] - evidence.t[rows[0]]
            t[rows] = begins + np.maximum(elapsed, 0.0)
            begins = float(t[rows].max())
    return t
