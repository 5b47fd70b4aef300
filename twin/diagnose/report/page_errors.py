"""The part of the report that shows where the simulation is wrong, and what of it is left."""

from __future__ import annotations

import html
import math

from twin.diagnose.judge.account import beyond_floor
from twin.diagnose.report.figures import (
    correction_figure,
    curve_figure,
    drawn,
    regime_figure,
    spectrum_figure,
    step_difference_figure,
    steps_figure,
)
from twin.diagnose.report.sentences import LACKED, WHERE_JUDGED, capital, percent
from twin.diagnose.residuals.step_response import Steps
from twin.diagnose.residuals.summary import Show
from twin.diagnose.result import Diagnosis
from twin.estimation.step_figures import FIGURES, definition
from twin.page import bullets, figures, paragraph, table, untested

_QUICK_REGIMES = ("position", "speed")
_STEP_FIGURES = ("rise_s", "settling_s", "overshoot")


def where(found: Diagnosis, show: Show) -> str:
    """Error by regime and frequency, the reference steps, the force and the current that are missing."""
    regimes = [one for one in show.regimes if not found.quick or one.name in _QUICK_REGIMES]
    drawings = [drawn(regime_figure(one, show.floor_m), f"Error 20 ms ahead by {one.title}") for one in regimes]
    if show.spectrum is not None and not found.quick:
        caption = (
            f"Spectrum of the error one sample ahead ({show.spectrum.segments} segments); noise alone is a flat line"
        )
        drawings.append(drawn(spectrum_figure(show.spectrum), caption))
    parts = [figures(drawings)]
    if drawings:
        parts.append(
            paragraph(
                "Each point: root mean square over the samples predicted in that group, bars as above. In the spectrum "
                "a wrong model may lie under the floor: its filter follows the readings more closely than a right one "
                "would, and pays for it at other frequencies and at longer horizons."
            )
        )
    if isinstance(show.steps, Steps):
        parts.append(
            "<h3>Is the rig slower than the simulation?</h3>" + _steps(show.steps, found.before == found.after)
        )
    elif not found.quick:
        parts.append("<h3>Is the rig slower than the simulation?</h3>" + untested(show.steps))
    residuals = [*show.force, *(() if found.quick else show.current)]
    if residuals:
        captions = {"N": "Force that is not explained", "A": "Current that was not foreseen, one sample ahead"}
        parts.append(
            "<h3>The force and the current that are missing</h3>"
            + figures(
                [drawn(curve_figure(one), f"{captions[one.residual_unit]}, over {one.title}") for one in residuals]
            )
            + paragraph(
                "Force: mass times (measured acceleration - that of the model). The measured one is the curvature of a "
                "parabola through 30 ms of readings, the model's is averaged with the same weights, from the measured "
                "current. Speeds of a ball at rest are one group: there the parabola sees noise. Current: what "
                "equation (1) did not foresee from one sample to the next. Means "
                f"over groups of the {len(found.fit_evidence.records)} recordings for fitting, which fly further than "
                "those that judge; bars: 95 %, bootstrap over blocks of half a second."
            )
        )
    return "".join(parts) or untested("no flight is long enough")


def _steps(steps: Steps, alone: bool) -> str:
    drawings = [
        drawn(steps_figure(steps), f"Mean of {steps.count} reference steps, each as a share of itself"),
        drawn(step_difference_figure(steps), "Rig minus simulation"),
    ]
    rows, pace = [], ""
    for first, second in steps.figures:
        if first.name not in _STEP_FIGURES or not first.count:
            continue
        _, unit, factor = FIGURES[first.name]
        title = definition(first.name, first.bands)
        cells = [f"{title} [{unit}]", f"{first.rig * factor:.4g}", f"{first.simulation * factor:.4g}"]
        for one in (first,) if alone else (first, second):
            ends = one.ci95 or (math.nan, math.nan)
            cells.append(f"{one.difference * factor:+.3g} ({ends[0] * factor:+.3g} .. {ends[1] * factor:+.3g})")
        if not alone:
            cells.insert(3, f"{second.simulation * factor:.4g}")
        rows.append([*cells, f"{first.count} of {first.steps}"])
        if first.name == "rise_s" and first.ci95 is not None:
            pace = _pace(first.difference, first.rig, first.ci95, second.ci95, alone)
    head = ["", "rig", "baseline", "extended", "rig - baseline", "rig - extended", "steps"]
    if alone:
        head = ["", "rig", "simulation", "rig - simulation", "steps"]
    return (
        (f"<p><b>{html.escape(pace)}</b></p>" if pace else "")
        + figures(drawings)
        + table(head, rows)
        + paragraph(
            "Both simulations run under the board's law, from the rig's first state, with the recorded reference and "
            "sensor noise. Differences are paired step by step; intervals: 95 %, Student's t over the steps."
        )
    )


def _pace(
    difference_s: float,
    rig_s: float,
    first: tuple[float, float],
    second: tuple[float, float] | None,
    alone: bool,
) -> str:
    same = "the simulation" if alone else "the baseline simulation"
    if first[0] <= 0.0 <= first[1]:
        return f"The rig is as fast as {same}, within {max(abs(first[0]), abs(first[1])) * 1e3:.2g} ms."
    slower = "slower" if difference_s > 0.0 else "faster"
    text = f"The rig is {slower} than {same}: {abs(difference_s) * 1e3:.2g} ms of {rig_s * 1e3:.3g} ms rise time."
    if alone or second is None:
        return text
    gone = second[0] <= 0.0 <= second[1]
    rest = "The extended model is as fast as the rig." if gone else "The extended model does not explain all of it."
    return f"{text} {rest}"


def left(found: Diagnosis, show: Show) -> str:
    """What the extended model does not explain, and the correction without a cause."""
    parts = []
    if found.verdict in ("unknown-cause", "partly-explained"):
        parts.append(paragraph(_rest(found)))
        largest = _largest(show)
        if largest:
            parts.append("<p>The extended model's error 20 ms ahead is largest</p>" + bullets(largest))
        parts.append(
            paragraph(
                "Nothing in the catalogue does that. Look at the pictures above for the quantity that it follows: a "
                "force over x or i_c is magnetic or of the sensor, one over x' is friction, a line in the spectrum is "
                "something that turns or swings, an error over time is something that warms up or comes loose."
            )
        )
    else:
        parts.append(
            paragraph(
                "Nothing that can be measured: what is left is white, and no larger than the error of the noise level."
                if found.causes
                else "Sensor noise: what is left is as large as at rest, and white."
            )
        )
    if show.correction is not None:
        one = show.correction
        ratio = one.ratio
        gain = (
            f"from {one.extended_rmse_m * 1e6:.3g} to {one.corrected_rmse_m * 1e6:.3g} µm (factor {ratio.low:.2f} .. "
            f"{ratio.high:.2f}, 95 %) on the judge recordings"
        )
        verdict = "It helps" if ratio.high < 1.0 else "It does not help" if ratio.low > 1.0 else "It hardly matters"
        parts.append(
            "<h3>A correction without a cause</h3>"
            + figures([drawn(correction_figure(one), "For prediction only, not a cause")])
            + paragraph(
                "For prediction only, not a cause: the mean error 20 ms ahead over position and speed, learnt on the "
                "recordings for fitting, is taken off the prediction. " + f"{verdict}: {gain}."
            )
        )
    return "".join(parts)


def _rest(found: Diagnosis) -> str:
    """What is left, and of which quantity."""
    if beyond_floor(found.gain) and found.unexplained_where.startswith(WHERE_JUDGED):
        return f"Nothing measurable of the recordings for fitting, but not all is explained {found.unexplained_where}."
    share = percent(found.account.unexplained)
    text = f"{capital(share)} of {LACKED} on the recordings for fitting is left, and it is no sensor noise."
    return text + (f" It is largest {found.unexplained_where.removeprefix('most ')}." * bool(found.unexplained_where))


def _largest(show: Show) -> list[str]:
    """For each sorting quantity the group with the largest error, where it stands out."""
    lines = []
    for regime in show.regimes:
        worst = max(regime.bins, key=lambda one: one.extended.value)
        least = min(regime.bins, key=lambda one: one.extended.value)
        if worst.extended.low > least.extended.high:
            lines.append(
                f"{regime.title}: {worst.label}, {worst.extended.value * 1e6:.3g} µm "
                f"(least: {least.label}, {least.extended.value * 1e6:.3g} µm)"
            )
    return lines
