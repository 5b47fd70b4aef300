"""The figures of a comparison: errors over the horizon, error by region, parameters in their order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from twin.comparison.errors import Change
from twin.comparison.parameters import Course
from twin.distributions import Z_95
from twin.page.figures import EXTENDED, MODEL, REFERENCE, grid, legend_above, styled

COLUMNS = 2
MAX_TICKS = 8


@styled
def error_figure(changes: Sequence[Change], names: Sequence[str]) -> Figure:
    """Draw both errors over the horizon, and their ratio with its interval."""
    figure, axes = grid(2, 1, height=5.6, width=7.2, ratios=[1.6, 1.0])
    top, bottom = axes[0][0], axes[1][0]
    h = [change.horizon_s * 1e3 for change in changes]
    top.loglog(h, [c.first_m * 1e6 for c in changes], color=MODEL, marker="o", label=names[0])
    top.loglog(h, [c.second_m * 1e6 for c in changes], color=EXTENDED, marker="s", ls="--", label=names[1])
    top.set_ylabel("rms error of x [µm]")
    legend_above(top)
    ratio = np.array([c.ratio for c in changes])
    ends = np.array([c.ci95 for c in changes])
    bars = [ratio - ends[:, 0], ends[:, 1] - ratio]
    bottom.errorbar(h, ratio, yerr=bars, color="black", marker="o", ls="", capsize=4)
    bottom.axhline(1.0, color=REFERENCE, lw=0.8)
    bottom.set(xscale="log", yscale="log", xlabel="prediction horizon [ms]", ylabel="second / first [-]")
    bottom.set_xticks(h, [f"{value:g}" for value in h])
    bottom.minorticks_off()
    return figure


@styled
def course_figure(courses: Sequence[Course], days: Sequence[str], names: Sequence[str]) -> Figure:
    """Draw each parameter over time, or over the order of the models where a day is unknown."""
    rows = -(-len(courses) // COLUMNS)
    figure, axes = grid(rows, COLUMNS, height=2.4 * rows + 0.6)
    dated = all(days)
    at = np.array(days, dtype="datetime64[D]") if dated else np.arange(1, len(names) + 1)
    for n, course in enumerate(courses):
        ax = axes[n // COLUMNS][n % COLUMNS]
        half = Z_95 * np.array(course.stds)
        ax.errorbar(at, course.values, yerr=half, color=MODEL if course.significant else "black", marker="o", capsize=4)
        ax.set_title(course.name + (": changed" if course.significant else ""))
        ax.set_ylabel(f"{course.name.split(': ')[-1]} [{course.unit or '-'}]")
        ax.tick_params(axis="x", rotation=30 if dated else 0, labelbottom=True)
        ax.set_xticks(at[:: -(-len(at) // MAX_TICKS)])
    for n in range(len(courses), rows * COLUMNS):
        axes[n // COLUMNS][n % COLUMNS].set_visible(False)
    for ax in axes[-1]:
        ax.set_xlabel("day of measurement" if dated else "model, in the order given")
    return figure
