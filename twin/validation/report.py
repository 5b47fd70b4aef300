"""The report: one HTML page that needs nothing else, and the same numbers as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twin.estimation.record import FloatArray
from twin.estimation.step_figures import FIGURES, Compared, RigFigure, definition
from twin.model.assumed import assumption
from twin.page.figures import Picture, inline
from twin.page.plain import plain
from twin.page.render import Mark, render, yes_or_no
from twin.validation import figures
from twin.validation.amplifier import CURRENT_FIGURES
from twin.validation.ball import Ahead
from twin.validation.residuals import Channel
from twin.validation.verdict import Validation

MAX_LOOPS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page that another room gives."""

    title: str
    answer: str
    tested: bool  # False: the answer is the reason why not
    head: tuple[str, ...]
    rows: list[list[str | Mark]]
    pictures: list[Picture]


def to_dict(result: Validation) -> dict[str, Any]:
    """The numbers without the traces; NaN becomes None, a part that is not testable {"not_testable": why}."""
    loop = result.loop
    amplifier = result.amplifier
    windows = result.windows
    parts: dict[str, Any] = {
        "passed": result.passed,
        "answer": result.answer(),
        "failures": result.failures(),
        "parameters": {name: p.value for name, p in result.model.parameters.items()},
        "recordings": list(result.flown),
        "notes": list(result.notes),
        "amplifier": _why(amplifier)
        if isinstance(amplifier, str)
        else {name: getattr(amplifier, name) for name in ("fit_percent", "rmse_a", "noise_a", "from_steps", "fitted")}
        | {"steps": [asdict(row) for row in amplifier.steps]},
        "ball_open_loop": _why(windows)
        if isinstance(windows, str)
        else {name: getattr(windows, name) for name in ("fit_percent", "rmse_m", "count")},
        "ahead": [asdict(row) for row in result.ahead],
        "residuals": _why(result.channels)
        if isinstance(result.channels, str)
        else [asdict(channel) | {"passed": channel.passed} for channel in result.channels],
        "closed_loop": _why(loop) | {"rig_alone": [asdict(row) for row in result.rig_figures]}
        if isinstance(loop, str)
        else {
            "fit_percent": loop.fit_percent,
            "rmse_m": loop.rmse_m,
            "expected_m": loop.expected_m,
            "steps": [asdict(row) for row in loop.steps],
            "without": list(loop.without),
            "pace": result.pace(),
        },
    }
    return plain(parts)


def to_html(result: Validation, *, title: str, further: Section | None = None) -> str:
    """The page; `further` is its last section."""
    p, loop, failures = result.model.parameters, result.loop, result.failures()
    plant = result.model.plant
    return render(
        "validation/report.html",
        title=title,
        answer=result.answer(),
        colour={True: "pass", False: "fail", None: ""}[result.passed],
        values=", ".join(f"{name} = {p[name].value:.5g} {p[name].unit}" for name in p)
        + f"; K_c and b {assumption(plant)}" * plant.assumed,
        result=result,
        failures=failures if len(failures) > 1 else [],
        pictures={part: inline(figure, caption) for part, (figure, caption) in drawn(result).items()},
        loops=_loops(result),
        ahead=[_ahead_row(row) for row in result.ahead],
        residuals=[] if isinstance(result.channels, str) else [_residual_row(channel) for channel in result.channels],
        amplifier_steps=_amplifier_steps(result),
        loop_steps=[] if isinstance(loop, str) else [_step_row(row, FIGURES) for row in loop.steps],
        expected="" if isinstance(loop, str) else _expected(loop.expected_m),
        recordings=len({run.name for run in result.measured}),
        rig_figures=[_rig_row(row) for row in result.rig_figures],
        further=further,
    )


def drawn(result: Validation) -> dict[str, tuple[Figure, str]]:
    """Draw the figures of all testable parts but the closed loops: figure and caption by name."""
    pictures = {}
    if not isinstance(result.amplifier, str):
        figure = figures.amplifier_figure(result.amplifier, result.model.T_A)
        pictures["amplifier"] = figure, "measured current against equation (1)"
    if not isinstance(result.windows, str):
        figure = figures.ball_figure(result.windows, result.model.plant.travel_m)
        pictures["ball"] = figure, "measured position and short predictions"
    if result.ahead:
        pictures["prediction"] = figures.ahead_figure(result.ahead), "error over the horizon"
    if not isinstance(result.channels, str):
        pictures["residuals"] = figures.residual_figure(result.channels), "residual correlations"
    if not isinstance(result.loop, str) and result.loop.steps:
        pictures["steps"] = figures.step_figure(result.loop.responses), "mean step response of rig and simulation"
    return pictures


def _loops(result: Validation) -> list[Picture]:
    """Draw rig and simulation for the first recordings, or the rig alone if its control law is unknown."""
    what, runs = "measured closed loop", result.measured
    if isinstance(result.loop, str):
        runs = tuple(run for k, run in enumerate(runs) if run.name not in {earlier.name for earlier in runs[:k]})
    else:
        what, runs = "closed loop", result.loop.runs
    travel_m = result.model.plant.travel_m
    return [inline(figures.loop_figure(run, travel_m), f"{what} of {run.name}") for run in runs[:MAX_LOOPS]]


def _ahead_row(row: Ahead) -> list[str | Mark]:
    return [
        f"{row.horizon_s * 1e3:.0f} ms",
        f"{row.rmse_m * 1e6:.4g}",
        f"{row.floor_m * 1e6:.4g}",
        f"{row.ratio:.3f}",
        f"{row.ratio_ci95[0]:.3f} .. {row.ratio_ci95[1]:.3f}",
        f"{row.still_m * 1e6:.4g}",
        f"{row.count}",
        yes_or_no(row.at_floor) if row.beats_still or not row.at_floor else "worse than a constant x",
    ]


def _residual_row(channel: Channel) -> list[str | Mark]:
    return [
        channel.name,
        f"{channel.count}",
        f"{channel.chi2:.4f} (1 ± {channel.chi2_bound:.3f})",
        yes_or_no(channel.size_right),
        _correlation(channel.autocorrelation, channel.p_white),
        yes_or_no(channel.white),
        _correlation(channel.cross_correlation, channel.p_input),
        yes_or_no(channel.independent),
        f"{channel.mean:+.3f}",
    ]


def _correlation(values: FloatArray, p: float) -> str:
    return f"{float(np.max(np.abs(values))):.3f}, " + (f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6")


def _expected(rmse_m: float) -> str:
    return f"{rmse_m * 1e6:.3g} µm" if math.isfinite(rmse_m) else "unknown (the model's loop is unstable)"


def _rig_row(row: RigFigure) -> list[str]:
    _, unit, factor = FIGURES[row.name]
    mean, low, high = (f"{value * factor:.4g}" for value in (row.rig, *row.ends))
    cells = [mean, f"{low} .. {high}"] if row.count else ["-", "-"]
    return [f"{definition(row.name, row.bands)} [{unit}]", *cells, f"{row.count} of {row.steps}"]


def _amplifier_steps(result: Validation) -> list[list[str | Mark]]:
    """Return the rows of the step responses; empty if no step has a figure."""
    if isinstance(result.amplifier, str) or not any(row.count for row in result.amplifier.steps):
        return []
    return [_step_row(row, CURRENT_FIGURES) for row in result.amplifier.steps]


def _step_row(row: Compared, figures: Mapping[str, tuple[str, str, float]]) -> list[str | Mark]:
    _, unit, factor = figures[row.name]
    title, count = f"{definition(row.name, row.bands, figures)} [{unit}]", f"{row.count} of {row.steps}"
    if not row.count:
        return [title, "-", "-", "-", f"measured in {row.rig_count}, simulated in {row.simulation_count}", count, ""]
    interval = "none: one step"
    verdict: str | Mark = ""
    if row.ci95 is not None:
        interval = f"{row.ci95[0] * factor:+.3g} .. {row.ci95[1] * factor:+.3g}"
        verdict = Mark("different", good=False) if row.significant else "no difference"
    rig, simulation = (f"{value * factor:.4g}" for value in (row.rig, row.simulation))
    return [title, rig, simulation, f"{row.difference * factor:+.3g}", interval, count, verdict]


def _why(reason: str) -> dict[str, Any]:
    return {"not_testable": reason}
