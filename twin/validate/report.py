"""The report: one HTML page that needs nothing else, and the same numbers as JSON."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from twin.estimation.step_figures import FIGURES, Compared, definition
from twin.page import bullets, mark, paragraph, table, untested, whole
from twin.validate.amplifier import CURRENT_FIGURES
from twin.validate.figures import (
    ahead_figure,
    amplifier_figure,
    ball_figure,
    loop_figure,
    picture,
    residual_figure,
    step_figure,
)
from twin.validate.residuals import Channel
from twin.validate.verdict import ClosedLoop, Validation

MOST_LOOPS = 3


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
        "closed_loop": _why(loop) | {"rig_alone": [asdict(row) for row in result.alone]}
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
    cleaned = _clean(parts)
    assert isinstance(cleaned, dict)
    return cleaned


def to_html(result: Validation, *, title: str) -> str:
    """The page."""
    colour = {True: "pass", False: "fail", None: ""}[result.passed]
    p = result.model.parameters
    values = ", ".join(f"{name} = {p[name].value:.5g} {p[name].unit}" for name in p)
    body = [
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="answer {colour}">{html.escape(result.answer())}</p>',
        f"<p>{html.escape(values)}.<br>Judged on: {html.escape(', '.join(result.flown) or 'no flight')}.</p>",
    ]
    failures = result.failures()
    if len(failures) > 1:
        body.append(bullets(failures))
    if result.notes:
        body.append("<h3>Notes</h3>" + bullets(result.notes))
    body += ["<h2>1 Amplifier, open loop (the paper's figure 7)</h2>", _amplifier(result)]
    body += ["<h2>2 Ball, open loop (figure 8)</h2>", _ball(result)]
    body += ["<h2>3 Prediction error against the noise floor</h2>", _ahead(result)]
    body += ["<h2>4 Residuals</h2>", _residuals(result.channels)]
    body += ["<h2>5 Closed loop, simulated and measured (figures 11 and 12)</h2>", _loop(result)]
    return whole(title, body)


def _amplifier(result: Validation) -> str:
    a = result.amplifier
    if isinstance(a, str):
        return untested(a)
    origin = "amplifier steps" if a.from_steps else "no amplifier step: the u_c and i_c of the other recordings"
    fitted = "; not marked for judging, so possibly fitted" if a.fitted else ""
    return (
        picture(amplifier_figure(a, result.model.T_A), "measured current against equation (1)")
        + paragraph(
            f"Fit {a.fit_percent:.2f} %, RMSE {a.rmse_a * 1e3:.3g} mA; the sensor's noise is {a.noise_a * 1e3:.3g} mA. "
            f"From {origin}{fitted}. (1) is driven by u_c alone; {len(a.traces)} traces."
        )
        + _amplifier_steps(a.steps)
    )


def _amplifier_steps(steps: Sequence[Compared]) -> str:
    if not any(row.count for row in steps):
        return ""
    head = ["", "measured", "(1)", "measured - (1)", "95 % interval", "steps", ""]
    return table(head, [_step_row(row, CURRENT_FIGURES) for row in steps])


def _ball(result: Validation) -> str:
    w = result.windows
    if isinstance(w, str):
        return untested(w)
    return picture(ball_figure(w, result.model.plant.travel_m), "measured position and short predictions") + paragraph(
        f"{w.name}, the liveliest stretch. Fit {w.fit_percent:.2f} %, RMSE {w.rmse_m * 1e6:.3g} µm over {w.count} "
        "windows of 40 ms. The ball is unstable: an error of the start grows by e every few samples, so a longer free "
        "run shows the instability and not the model. Each window starts from the filter's estimate and is driven by "
        "the recorded u_c alone; a ball that reaches a stop stands there."
    )


def _ahead(result: Validation) -> str:
    if not result.ahead:
        return untested("no flight is long enough")
    rows = [
        [
            f"{row.horizon_s * 1e3:.0f} ms",
            f"{row.rmse_m * 1e6:.4g}",
            f"{row.floor_m * 1e6:.4g}",
            f"{row.ratio:.3f}",
            f"{row.ratio_ci95[0]:.3f} .. {row.ratio_ci95[1]:.3f}",
            f"{row.still_m * 1e6:.4g}",
            f"{row.count}",
            mark(row.at_floor) if row.beats_still or not row.at_floor else "worse than x stays",
        ]
        for row in result.ahead
    ]
    head = [
        "ahead",
        "rms error [µm]",
        "noise floor [µm]",
        "ratio",
        "95 % interval",
        "x stays [µm]",
        "count",
        "at the floor",
    ]
    return (
        picture(ahead_figure(result.ahead), "error over the horizon")
        + table(head, rows)
        + paragraph(
            "The floor is what sensor noise alone leaves of a right model. At the floor: the interval reaches 1.05, "
            "and the error is no larger than that of x that stays where it is. Where a loop holds the ball and the "
            "noise is large, even a right model is worse than that at the longer horizons: they tell nothing then. A "
            "model that is worse at all of them predicts nothing, and fails."
        )
    )


def _residuals(channels: Sequence[Channel] | str) -> str:
    if isinstance(channels, str):
        return untested(channels)
    rows = [
        [
            c.name,
            f"{c.count}",
            f"{c.chi2:.4f} (1 ± {c.chi2_bound:.3f})",
            mark(c.size_right),
            f"{float(np.max(np.abs(c.autocorrelation))):.3f}, {_chance(c.p_white)}",
            mark(c.white),
            f"{float(np.max(np.abs(c.cross_correlation))):.3f}, {_chance(c.p_input)}",
            mark(c.independent),
            f"{c.mean:+.3f}",
        ]
        for c in channels
    ]
    head = [
        "residual of",
        "samples",
        "mean square (99 %)",
        "as stated",
        "autocorrelation",
        "white",
        "with past u_c",
        "free of u_c",
        "mean",
    ]
    return (
        picture(residual_figure(channels), "residual correlations")
        + table(head, rows)
        + paragraph(
            "Prediction errors one step ahead in units of their stated standard deviation: a right model leaves a mean "
            "square of 1 and no correlation. Largest of 25 lags; p: chi-square over all of them, refused below 0.001 "
            "unless every correlation is under 0.015. Only past u_c is compared: in closed loop later u_c answers e."
        )
    )


def _chance(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-6 else "p &lt; 1e-6"


def _loop(result: Validation) -> str:
    loop = result.loop
    if isinstance(loop, str):
        return untested(loop) + _measured(result)
    images = "".join(
        picture(loop_figure(run, result.model.plant.travel_m), f"closed loop of {run.name}")
        for run in loop.runs[:MOST_LOOPS]
    )
    expected = (
        f"{loop.expected_m * 1e6:.3g} µm"
        if math.isfinite(loop.expected_m)
        else "unknown (the model's loop is unstable)"
    )
    text = paragraph(
        f"Fit {loop.fit_percent:.2f} %, RMSE {loop.rmse_m * 1e6:.3g} µm against the noise-free simulation; noise alone "
        f"leaves {expected}. The simulation gets the recorded reference, and the rig's state at its first instant."
    )
    without = "<p>Not simulated:</p>" + bullets(loop.without) if loop.without else ""
    return images + text + _steps(loop, result.pace()) + without


def _measured(result: Validation) -> str:
    """The rig alone, where no law is known to simulate it under."""
    shown: dict[str, str] = {}
    for run in result.measured:
        if run.name not in shown and len(shown) < MOST_LOOPS:
            shown[run.name] = picture(
                loop_figure(run, result.model.plant.travel_m), f"measured closed loop of {run.name}"
            )
    if not shown:
        return ""
    text = paragraph(f"The rig alone, {len(shown)} of {len({run.name for run in result.measured})} recordings.")
    if not result.alone:
        return text + "".join(shown.values())
    rows = []
    for row in result.alone:
        _, unit, factor = FIGURES[row.name]
        title = definition(row.name, row.bands)
        ends = f"{row.ends[0] * factor:.4g} .. {row.ends[1] * factor:.4g}" if row.count else "-"
        value = f"{row.rig * factor:.4g}" if row.count else "-"
        rows.append([f"{title} [{unit}]", value, ends, f"{row.count} of {row.steps}"])
    return (
        text
        + "".join(shown.values())
        + table(["", "rig, mean", "from .. to", "steps"], rows)
        + paragraph("Where fewer than all steps have a figure, it did not happen before the reference moved on.")
    )


def _steps(loop: ClosedLoop, pace: str) -> str:
    if not loop.steps:
        return untested("steps: the reference has no step after which it stays for 0.15 s")
    rows = [_step_row(row, FIGURES) for row in loop.steps]
    head = ["", "rig", "simulation", "rig - simulation", "95 % interval", "steps", ""]
    return (
        f"<p><b>{html.escape(pace)}</b></p>"
        + picture(step_figure(loop.responses), "mean step response of rig and simulation")
        + table(head, rows)
        + paragraph(
            "Means over the steps; the simulation over 8 realisations of its noise. Interval: Student's t over steps, "
            "paired. Rise time: from 10 % to 90 % of the step. Settling time: from the first change of the reference "
            "until x, averaged over 10 ms, stays within the band around the new reference; the band is 5 % of the step "
            "or 4 standard deviations of the noise, whichever is wider, and a step that would need more than 10 % has "
            "no settling time. Overshoot: of x averaged over 10 ms, as a share of the step. IAE: integral of "
            "|x_ref - x|. Control effort: integral of (u_c - its final level)^2."
        )
    )


def _step_row(row: Compared, figures: Mapping[str, tuple[str, str, float]]) -> list[str]:
    _, unit, factor = figures[row.name]
    title = definition(row.name, row.bands, figures)
    if not row.count:
        return [
            f"{title} [{unit}]",
            "-",
            "-",
            "-",
            f"measured in {row.rig_count}, simulated in {row.simulation_count}",
            f"0 of {row.steps}",
            "",
        ]
    interval, verdict = "none: one step", ""
    if row.ci95 is not None:
        low, high = row.ci95[0] * factor, row.ci95[1] * factor
        interval = f"{low:+.3g} .. {high:+.3g}"
        verdict = "<span class=no>different</span>" if row.significant else "no difference"
    numbers = [f"{value * factor:.4g}" for value in (row.rig, row.simulation)]
    return [
        f"{title} [{unit}]",
        *numbers,
        f"{row.difference * factor:+.3g}",
        interval,
        f"{row.count} of {row.steps}",
        verdict,
    ]


def _why(reason: str) -> dict[str, Any]:
    return {"not_testable": reason}


def _clean(value: object) -> object:
    if isinstance(value, dict):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_clean(entry) for entry in value]
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
