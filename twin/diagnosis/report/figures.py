"""The figures of the report: measured blue, baseline red, extended green, noise floor grey.

Rule 1: each picture has one panel, as wide as a phone; on a desktop two stand side by side.
Rule 2: the same colours and the same order everywhere; error bars are 95 % intervals.
Rule 3: the same numbers give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.diagnosis.remainder.remainder import Shape
from twin.diagnosis.residuals.force import Curve
from twin.diagnosis.residuals.regimes import Estimate, Regime
from twin.diagnosis.residuals.spectrum import Spectrum
from twin.diagnosis.residuals.step_response import Steps
from twin.diagnosis.residuals.summary import Ahead, Piece
from twin.diagnosis.search.forward_step import Round
from twin.estimation.record import FloatArray
from twin.page.figures import EXTENDED, MEASURED, MODEL, REFERENCE, label, styled, ticks_125

BASELINE, FLOOR = MODEL, REFERENCE
MAX_BARS = 8
_SCALES = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "N": (1e3, "mN")}


@styled
def ahead_figure(rows: Sequence[Ahead]) -> Figure:
    """Draw the errors over the horizon."""
    figure, ax = panel()
    h = np.array([row.horizon_s for row in rows]) * 1e3
    for name, colour, estimates in _sides([row.baseline for row in rows], [row.extended for row in rows]):
        _bars(ax, h, estimates, 1e6, name, colour)
    ax.plot(h, [row.floor_m * 1e6 for row in rows], color=FLOOR, ls="--", lw=1.2, label="noise floor")
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(h, [f"{value:.3g}" for value in h])
    ax.minorticks_off()
    ticks_125(ax, *ax.get_ylim())
    label(ax, "prediction horizon [ms]", "rms error of x [µm]")
    return figure


@styled
def piece_figure(piece: Piece) -> Figure:
    """Draw x as measured and as both models predicted it."""
    figure, ax = panel()
    t = piece.t_s - piece.t_s[0]
    ax.plot(t, piece.x_m * 1e3, color=MEASURED, lw=2.6, label="measured")
    ax.plot(t, piece.baseline_m * 1e3, color=BASELINE, lw=1.0, label="baseline")
    if not np.array_equal(piece.extended_m, piece.baseline_m):
        ax.plot(t, piece.extended_m * 1e3, color=EXTENDED, lw=1.0, label="extended")
    label(ax, "time [s]", "position x [mm]")
    return figure


@styled
def error_figure(piece: Piece, floor_m: float) -> Figure:
    """Draw the errors of both models over the same time."""
    figure, ax = panel()
    t = piece.t_s - piece.t_s[0]
    if np.isfinite(floor_m):
        ax.axhspan(-2e6 * floor_m, 2e6 * floor_m, color=FLOOR, alpha=0.2, lw=0, label="2 std of noise alone")
    ax.plot(t, (piece.baseline_m - piece.x_m) * 1e6, color=BASELINE, lw=0.9, label="baseline")
    if not np.array_equal(piece.extended_m, piece.baseline_m):
        ax.plot(t, (piece.extended_m - piece.x_m) * 1e6, color=EXTENDED, lw=0.9, label="extended")
    label(ax, "time [s]", "predicted - measured [µm]")
    return figure


@styled
def regime_figure(regime: Regime, floor_m: float) -> Figure:
    """Draw the errors in each group."""
    named = not regime.unit
    count = len(regime.bins)
    figure, ax = panel(height=max(2.4, 1.2 + 0.34 * count) if named else 3.4, left=0.36 if named else 0.15)
    factor, unit = _SCALES.get(regime.unit, (1.0, regime.unit))
    sides = _sides([bin_.baseline for bin_ in regime.bins], [bin_.extended for bin_ in regime.bins])
    for index, (name, colour, estimates) in enumerate(sides):
        if named:
            at = np.arange(count, dtype=np.float64) + 0.24 * (index - 0.5 * (len(sides) - 1))
            _bars(ax, at, estimates, 1e6, name, colour, sideways=True)
        else:
            _bars(ax, np.array([bin_.at for bin_ in regime.bins]) * factor, estimates, 1e6, name, colour)
    line = ax.axvline if named else ax.axhline
    if np.isfinite(floor_m):
        line(floor_m * 1e6, color=FLOOR, ls="--", lw=1.2, label="noise floor")
    if named:
        ax.set_yticks(range(count), [short_label(bin_.label) for bin_ in regime.bins])
        ax.invert_yaxis()
        ax.set_xlim(left=0.0)
        label(ax, "rms error 20 ms ahead [µm]", "")
    else:
        ax.set_ylim(bottom=0.0)
        label(ax, f"{regime.title} [{unit}]", "rms error 20 ms ahead [µm]")
    return figure


@styled
def curve_figure(curve: Curve) -> Figure:
    """Draw a mean residual over one quantity."""
    figure, ax = panel()
    factor, unit = _SCALES.get(curve.unit, (1.0, curve.unit))
    what = "unexplained force [mN]" if curve.residual_unit == "N" else "unexplained current [mA]"
    at = np.array([point.at for point in curve.points]) * factor
    ax.axhline(0.0, color="black", lw=0.6)
    for name, colour, estimates in _sides([p.baseline for p in curve.points], [p.extended for p in curve.points]):
        _bars(ax, at, estimates, 1e3, name, colour)
    label(ax, f"{curve.title} [{unit}]", what)
    return figure


@styled
def spectrum_figure(spectrum: Spectrum) -> Figure:
    """Draw the densities of the error one sample ahead."""
    figure, ax = panel()
    for name, colour, density in _sides(spectrum.baseline, spectrum.extended):
        low, high = (density * factor * 1e6 for factor in spectrum.spread)
        ax.fill_between(spectrum.frequency_hz, low, high, color=colour, alpha=0.2, lw=0)
        ax.plot(spectrum.frequency_hz, density * 1e6, color=colour, lw=1.0, label=name)
    ax.axhline(spectrum.floor * 1e6, color=FLOOR, ls="--", lw=1.2, label="noise floor")
    ax.set(xscale="log", yscale="log")
    ticks_125(ax, *ax.get_ylim())
    label(ax, "frequency [Hz]", "error one sample ahead [µm/√Hz]")
    return figure


@styled
def steps_figure(steps: Steps) -> Figure:
    """Draw the mean step of the rig and of both simulations."""
    figure, ax = panel()
    t = steps.t_s * 1e3
    ax.axhline(1.0, color=REFERENCE, lw=0.8, ls=":")
    for name, colour, trace in (("rig", MEASURED, steps.rig), *_sides(steps.baseline, steps.extended)):
        ax.plot(t, trace, color=colour, lw=1.3, label=name)
    label(ax, "time from the change of the reference [ms]", "share of the step [-]")
    return figure


@styled
def step_difference_figure(steps: Steps) -> Figure:
    """Draw rig minus simulation."""
    figure, ax = panel()
    t = steps.t_s * 1e3
    ax.axhline(0.0, color="black", lw=0.6)
    for name, colour, trace in _sides(steps.baseline, steps.extended):
        ax.plot(t, 100.0 * (steps.rig - trace), color=colour, lw=1.2, label=f"rig - {name}")
    label(ax, "time from the change of the reference [ms]", "difference [% of the step]")
    return figure


@styled
def round_figure(step: Round, number: int, threshold: float) -> Figure:
    """Draw the gain of each candidate of a round: as fitted, else as estimated by the score test."""
    fitted = {trial.cause: trial.gain for trial in step.trials}
    rows = [(cause, gain, True) for cause, gain in fitted.items()]
    rows += [(s.cause, s.gain, False) for s in step.scores if s.cause not in fitted and s.testable]
    rows = sorted(rows, key=lambda row: -row[1])[:MAX_BARS]
    figure, ax = panel(height=1.3 + 0.28 * max(len(rows), 3), left=0.4, top=0.35)
    for row_index, (cause, gain, is_fitted) in enumerate(rows):
        colour = EXTENDED if cause == step.selected else BASELINE if is_fitted else FLOOR
        ax.barh(row_index, max(gain, 0.0), height=0.7, color=colour, alpha=1.0 if is_fitted else 0.35)
    ax.axvline(threshold, color="black", lw=0.8, ls=":")
    names = [cause + (" ✓" if cause == step.selected else "") for cause, _, _ in rows]
    ax.set_yticks(range(len(rows)), names)
    ax.invert_yaxis()
    # Logarithmic beyond the threshold: gains span from chance to tens of thousands, and those below it matter little.
    ax.set_xscale("symlog", linthresh=threshold)
    ax.set_xlim(0.0, 1.6 * max([gain for _, gain, _ in rows], default=threshold) + threshold)
    ax.xaxis.set_minor_locator(matplotlib.ticker.NullLocator())
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("gain of log-likelihood")
    ax.set_title(f"round {number}: " + (f"{step.selected} selected" if step.selected else "none selected"))
    return figure


@styled
def shape_figure(shape: Shape) -> Figure:
    """Draw a curve through the remainder, with its 95 % band."""
    figure, ax = panel()
    known = shape.curve.parameters[0]
    factor, unit = _SCALES.get(known.unit, (1.0, known.unit))
    at = shape.at * factor
    ax.axhline(0.0, color="black", lw=0.6)
    ax.fill_between(at, 100.0 * shape.low, 100.0 * shape.high, color=EXTENDED, alpha=0.2, lw=0, label="95 % band")
    ax.plot(at, 100.0 * shape.share, color=EXTENDED, lw=1.3, label="estimate")
    label(ax, f"{known.symbol.removeprefix('from ')} [{unit}]", f"% {shape.curve.acts_on}")
    return figure


def _sides(baseline: Any, extended: Any) -> list[tuple[str, str, Any]]:
    """Return the values of both models, or of one if nothing was added."""
    if np.array_equal(baseline, extended):
        return [("model", BASELINE, baseline)]
    return [("baseline", BASELINE, baseline), ("extended", EXTENDED, extended)]


def _bars(
    ax: Axes, at: FloatArray, values: Sequence[Estimate], factor: float, name: str, colour: str, sideways: bool = False
) -> None:
    middle = np.array([estimate.value for estimate in values]) * factor
    low = np.maximum(middle - np.array([estimate.low for estimate in values]) * factor, 0.0)
    high = np.maximum(np.array([estimate.high for estimate in values]) * factor - middle, 0.0)
    marker = "s" if colour == EXTENDED else "o"  # for a print without colour
    style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4.5, "elinewidth": 1.2, "capsize": 3}
    if sideways:
        ax.errorbar(middle, at, xerr=[low, high], label=name, lw=0.0, **style)
    else:
        ax.errorbar(at, middle, yerr=[low, high], label=name, lw=1.0, **style)


def short_label(label: str) -> str:
    """Shorten a label: a recording to its name without folder and ending, a longer text to both of its ends."""
    stem = label.removesuffix(".gz").removesuffix(".csv").removesuffix(".mcap")
    if stem != label:  # "slower than 1 mm/s" is not a file
        label = stem.rpartition("/")[2]
    return label if len(label) <= 24 else label[:11] + "…" + label[-12:]


def panel(*, height: float = 3.4, left: float = 0.15, top: float = 0.34) -> tuple[Figure, Axes]:
    """Return a figure of one panel; sizes in inches, `left` as a share of the width."""
    figure = Figure(figsize=(5.6, height))
    figure.subplots_adjust(left=left, right=0.97, top=1.0 - top / height, bottom=0.6 / height)
    return figure, figure.subplots()
