"""Measured against twin as one picture: position, current, input, divergence with its alarm line.

Rule: what is not in step is not drawn as twin; gaps stay gaps.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from twin.mirror.output import IN_STEP, OUT_OF_STEP
from twin.page.figures import ALARM, MEASURED, MODEL, REFERENCE, styled

FLOOR_UM = 1.0  # lower end of the logarithmic axis of errors: below one count of the converter nothing is to be seen
AROUND_S = 0.5  # shown before and after the time in closed loop


@dataclass(slots=True)
class Traces:
    """Columns over the samples of one board, gathered with `add`; NaN where there is nothing."""

    board: str
    rows: list[tuple[float, ...]] = field(default_factory=list)
    alarms: list[tuple[float, str, bool]] = field(default_factory=list)  # (t, name, active)

    def add(self, state: pb.State, twin: pb.TwinState | None, divergence: pb.Divergence | None) -> None:
        """Add a sample."""
        nan = float("nan")
        visible = twin if twin is not None and twin.sync != OUT_OF_STEP else None
        comparison = divergence if divergence is not None and divergence.HasField("x_m") else None
        in_step = comparison if comparison is not None and comparison.sync == IN_STEP else None
        judged = divergence if divergence is not None and divergence.innovation_valid else None
        std = nan
        if comparison is not None and comparison.x_m.normalised != 0.0:
            std = abs(comparison.x_m.error / comparison.x_m.normalised)
        self.rows.append(
            (
                state.t_s,
                state.x_m if state.HasField("x_m") else nan,
                state.x_ref_m if state.HasField("x_ref_m") and state.mode == pb.MODE_CLOSED_LOOP else nan,
                state.i_c_a if state.HasField("i_c_a") else nan,
                state.u_c_v if state.HasField("u_c_v") else nan,
                visible.x_m if visible else nan,
                visible.i_c_a if visible else nan,
                visible.u_c_v if visible else nan,
                abs(in_step.x_m.error) if in_step else nan,
                in_step.x_m.rolling_rmse if in_step else nan,
                std,
                judged.nis_mean if judged else nan,
                judged.innovation_x_m if judged else nan,
            )
        )

    def note(self, alarms: Iterable[pb.Alarm], t_s: float) -> None:
        """Add the alarms of a sample."""
        self.alarms += [(t_s, alarm.name, alarm.active) for alarm in alarms]

    def crop(self, from_s: float | None, to_s: float | None) -> None:
        """Keep a span of board time; an end that is None is where the coil was first or last on, and a moment more."""
        used = [row[0] for row in self.rows if row[2] == row[2]]  # a reference is in force: closed loop
        if from_s is None:
            from_s = min(used) - AROUND_S if used else -math.inf
        if to_s is None:
            to_s = max(used) + AROUND_S if used else math.inf
        self.rows = [row for row in self.rows if from_s <= row[0] <= to_s]
        # An alarm that was raised before the span is on where it begins.
        before = {name: active for t, name, active in self.alarms if t < from_s}
        changes = [alarm for alarm in self.alarms if from_s <= alarm[0] <= to_s]
        self.alarms = [(from_s, name, True) for name, active in before.items() if active] + changes

    def part(self, from_s: float, to_s: float) -> Traces:
        """A copy of a span of board time."""
        copy = Traces(self.board, rows=self.rows, alarms=self.alarms)
        copy.crop(from_s, to_s)
        return copy

    def columns(self) -> NDArray[np.float64]:
        """Return all traces over the samples, shape (13, samples), NaN over gaps.

        t, x, x_ref, i, u, twin x, i, u, |error of x|, its rolling RMSE, its std, mean NIS, innovation of x.
        """
        table = np.array(self.rows, dtype=np.float64).reshape(-1, 13)
        steps = np.diff(table[:, 0])
        if len(steps) == 0:
            return table.T
        # Five periods: single lost samples stay joined, and a pause becomes a gap.
        breaks = np.flatnonzero((steps > 5.0 * np.median(steps)) | (steps <= 0.0)) + 1
        return np.insert(table, breaks, np.nan, axis=0).T


@styled
def draw(traces: Traces, out: Path, *, nis_on: float, error_on: float, title: str) -> None:
    """Write the picture.

    Args:
        traces: of one board.
        out: file; its suffix chooses the format.
        nis_on: threshold of the alarm on the mean NIS.
        error_on: threshold of the alarm on the mean squared normalised error of x; NaN where unknown.
        title: what is compared with what.
    """
    t, x, x_ref, i, u, twin_x, twin_i, twin_u, error, rmse, std, nis, _ = traces.columns()
    t = _continuous(t)
    figure = Figure(figsize=(12, 11), dpi=110, layout="constrained")
    axes = figure.subplots(5, 1, sharex=True, height_ratios=[2.4, 1.3, 1.3, 1.5, 1.2])
    figure.suptitle(title, fontsize=13)

    for axis, name in zip(axes, ("position x [mm]", "current i_c [A]", "input u_c [V]"), strict=False):
        axis.set_ylabel(name)
    pair(axes[0], t, x * 1e3, twin_x * 1e3)
    axes[0].plot(t, x_ref * 1e3, color=REFERENCE, lw=1.0, ls="--", label="reference", zorder=1)
    pair(axes[1], t, i, twin_i)
    pair(axes[2], t, u, twin_u)

    # Logarithmic: an error in step and a hundred times that after a change must both be readable.
    axes[3].semilogy(t, np.maximum(error * 1e6, FLOOR_UM), color="#bbbbbb", lw=0.6, label="|error|")
    axes[3].semilogy(t, rmse * 1e6, color=MODEL, lw=1.6, label="rolling RMSE")
    axes[3].semilogy(t, std * np.sqrt(error_on) * 1e6, color=ALARM, lw=1.4, ls="-.", label="alarm line")
    if not np.isfinite(twin_x).any():
        why = "no free twin: the log does not contain the control law"
        axes[3].text(0.5, 0.5, why, transform=axes[3].transAxes, ha="center", color=REFERENCE)
    axes[3].set_ylabel("x: measured - twin\n[µm]")
    axes[4].semilogy(t, nis, color=MODEL, lw=1.4, label="NIS, window mean")
    axes[4].axhline(2.0, color=REFERENCE, lw=0.9, ls=":", label="a right model: 2")
    axes[4].axhline(nis_on, color=ALARM, lw=1.4, ls="-.", label=f"alarm line: {nis_on:.2f}")
    axes[4].set_ylabel("one-step\ninnovation [-]")
    axes[4].set_xlabel("time on the board's clock [s]")

    end = float(np.nanmax(t))
    shade(axes[1], traces.alarms, "divergence-i_c", end)
    shade(axes[3], traces.alarms, "divergence-x", end)
    shade(axes[4], traces.alarms, "innovation", end)
    for axis in axes:
        shade(axis, traces.alarms, OUT_OF_STEP, end)
        axis.margins(x=0.005)
        axis.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), frameon=False)
    figure.savefig(out)


def pair(axis: Axes, t: NDArray[np.float64], measured: NDArray[np.float64], twin: NDArray[np.float64]) -> None:
    """Draw a signal of rig and twin over one another."""
    axis.plot(t, measured, color=MEASURED, lw=2.4, label="measured")
    axis.plot(t, twin, color=MODEL, lw=1.1, label="twin" if np.isfinite(twin).any() else None)


def _continuous(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The board's clock, running on over a reset: each session is put behind the one before."""
    result = t.copy()
    offset, last = 0.0, -np.inf
    for k, value in enumerate(t):
        if np.isnan(value):
            continue
        if value + offset < last:
            offset = last - value
        result[k] = last = value + offset
    return result


def shade(axis: Axes, alarms: Sequence[tuple[float, str, bool]], name: str, end: float) -> None:
    """Mark where an alarm, or being out of step, was on; alarms are (t, name, active)."""
    color = "#777777" if name == OUT_OF_STEP else ALARM
    label: str | None = f"alarm {name}" if name != OUT_OF_STEP else OUT_OF_STEP
    since: float | None = None
    for t, _, active in [*(alarm for alarm in alarms if alarm[1] == name), (end, name, False)]:
        if active and since is None:
            since = t
        elif not active and since is not None:
            axis.axvspan(since, t, color=color, alpha=0.15, lw=0, label=label)
            since = label = None
