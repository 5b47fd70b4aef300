"""Spans of one flight side by side, on the same scales: what another model, or another setting, changed.

Rule: each span counts its time from its own beginning; what is not in step is not drawn as twin.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from twin.mirror.plots.traces import Traces, pair, shade
from twin.page.figures import MODEL, REFERENCE, styled

CUT_SHARE = 0.005  # of the samples at either end may lie outside the axes of the errors


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A span of time: its traces and its label."""

    traces: Traces  # cropped to it
    label: str


@styled
def draw_spans(columns: list[Column], out: Path, *, title: str) -> None:
    """Write the picture: position, current, their difference in current, one-step innovation; a column per span."""
    figure = Figure(figsize=(6.6 * len(columns), 9.2), dpi=110, layout="constrained")
    axes = figure.subplots(4, len(columns), sharey="row", sharex="col", squeeze=False, height_ratios=[1.6, 1.4, 1.2, 1])
    figure.suptitle(title, fontsize=13)
    errors, innovations = [], []
    for k, column in enumerate(columns):
        error, innovation = _column(axes[:, k], column, first=k == 0)
        errors.append(error)
        innovations.append(innovation)
    # Of all spans together: on scales of their own, a bad span would look like a good one.
    _scale(axes[2, 0], np.concatenate(errors))
    _scale(axes[3, 0], np.concatenate(innovations))
    handles: dict[str, Artist] = {}  # each label once
    for axis in axes.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=len(handles), frameon=False)
    figure.savefig(out)


def _scale(axis: Axes, values: NDArray[np.float64]) -> None:
    """Show nearly all: the instant at which a ball is lifted would make a line of everything else."""
    known = values[np.isfinite(values)]
    if len(known):
        low, high = np.percentile(known, [100.0 * CUT_SHARE, 100.0 * (1.0 - CUT_SHARE)])
        low, high = min(low, 0.0), max(high, 0.0)
        room = 0.25 * max(high - low, 1e-6)
        axis.set_ylim(low - room, high + room)


def _column(
    axes: NDArray[np.object_], column: Column, *, first: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw a column; returns the error of i_c in mA and the innovation of x in µm."""
    rows = column.traces.columns()
    begin = float(np.nanmin(rows[0]))
    t, x, x_ref, i, twin_x, twin_i, innovation = (rows[0] - begin, *rows[[1, 2, 3, 5, 6, 12]])
    alarms = [(at - begin, name, active) for at, name, active in column.traces.alarms]
    end = float(np.nanmax(t))
    position, current, difference, surprise = axes
    position.set_title(column.label)
    pair(position, t, x * 1e3, twin_x * 1e3)
    position.plot(t, x_ref * 1e3, color=REFERENCE, lw=1.0, ls="--", label="reference", zorder=1)
    pair(current, t, i, twin_i)
    error = i - twin_i
    difference.axhline(0.0, color=REFERENCE, lw=0.8)
    difference.plot(t, error * 1e3, color=MODEL, lw=0.7)
    _write_rms(difference, error * 1e3, "mA")
    shade(difference, alarms, "divergence-i_c", end)
    surprise.axhline(0.0, color=REFERENCE, lw=0.8)
    surprise.plot(t, innovation * 1e6, color=MODEL, lw=0.7)
    _write_rms(surprise, innovation * 1e6, "µm")
    shade(surprise, alarms, "innovation", end)
    surprise.set_xlabel("time [s]")
    for axis in axes:
        axis.margins(x=0.005)
    if first:
        position.set_ylabel("position x [mm]")
        current.set_ylabel("current i_c [A]")
        difference.set_ylabel("i_c: measured - twin\n[mA]")
        surprise.set_ylabel("x: one-step\ninnovation [µm]")
    return error * 1e3, innovation * 1e6


def _write_rms(axis: Axes, values: NDArray[np.float64], unit: str) -> None:
    """Write the rms into the corner."""
    if np.isfinite(values).any():
        rms = float(np.sqrt(np.nanmean(values**2)))
        text = f"rms {rms:.3g} {unit}"
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 2.0}
        axis.text(0.99, 0.94, text, transform=axis.transAxes, ha="right", va="top", fontsize=10, bbox=box)
