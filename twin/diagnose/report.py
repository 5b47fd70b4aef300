"""The report of a diagnosis: one HTML page that needs nothing else.

The sentence, before and after, where the simulation is wrong, which cause and why, what to do, what is left, and how
to compute it again.

Rule 1: every number is that of diagnosis.json, or of `show.py`; nothing is estimated here.
Rule 2: a page of a model that is adequate, or of a cause that nobody knows, says what was looked at all the same.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

from twin.diagnose.figures import (
    ahead_figure,
    correction_figure,
    curve_figure,
    error_figure,
    piece_figure,
    regime_figure,
    spectrum_figure,
    step_difference_figure,
    steps_figure,
)
from twin.diagnose.report_causes import causes, not_the_cause, ranking
from twin.diagnose.response import Steps
from twin.diagnose.result import Diagnosis
from twin.diagnose.show import HORIZON_S, Show
from twin.diagnose.words import measured, percent, quantity
from twin.identify.prepare import Usage
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Parameter
from twin.page import bullets, drawing, figures, paragraph, table, untested, whole
from twin.validate.steps import FIGURES

_COLOUR = {"causes-found": "found", "model-adequate": "pass", "unknown-cause": "fail"}
_QUICK_REGIMES = ("position", "speed")
_STEP_FIGURES = ("rise_s", "settling_s", "overshoot")


def to_html(found: Diagnosis, show: Show, *, campaign: Path, out: Path) -> str:
    """The page.

    Args:
        found: of `diagnose`.
        show: of `shown`.
        campaign: as it was given, for the commands at the end.
        out: folder of the page, for the same.
    """
    title = f"What the simulation of {found.baseline.plant.name} gets wrong"
    body = [
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="answer {_COLOUR[found.verdict]}">{html.escape(found.sentence)}</p>',
        *_banners(found, show),
        paragraph(_about(found, campaign)),
        "<h2>Before and after</h2>",
        _before_after(found, show),
        "<h2>Where the simulation is wrong</h2>",
        _where(found, show),
        "<h2>Which cause</h2>",
        ranking(found),
    ]
    if found.causes:
        body += ["<h2>The causes, and what to do</h2>", causes(found)]
    body += [
        "<h2>What is left</h2>",
        _left(found, show),
        "<h2>The model's numbers</h2>",
        _numbers(found),
        "<h2>What was not the cause</h2>",
        not_the_cause(found),
        "<h2>How the campaign was used</h2>",
        _use(found),
        "<h2>Compute it again</h2>",
        _again(found, campaign, out),
    ]
    return whole(title, body)


def _banners(found: Diagnosis, show: Show) -> list[str]:
    lines = []
    if found.quick:
        lines.append(
            "Made with --quick: the confidence figures are not calibrated, and stand-ins were not searched for."
        )
    if not show.judged:
        lines.append(
            "No recording was left to judge by. Errors below are of the recordings that were fitted: they flatter."
        )
    return [f'<p class="warn">{html.escape(line)}</p>' for line in lines]


def _about(found: Diagnosis, campaign: Path) -> str:
    fit, judge = found.fit_evidence, found.judge_evidence
    names = ", ".join(judge.names()) if judge is not None else "none"
    text = (
        f"Campaign {campaign.name or campaign}: {len(fit.records)} recordings to fit and to choose causes on, "
        f"judged by {names}. Baseline: {found.baseline.provenance.get('about', 'the model that was given')}."
    )
    if found.causes:
        sure = ", ".join(f"{cause.name} {100 * cause.confidence:.0f} %" for cause in found.causes)
        text += f" Confidence in the name (or in its class): {sure}."
    return text


def _before_after(found: Diagnosis, show: Show) -> str:
    drawings = []
    if show.ahead:
        drawings.append(
            drawing(ahead_figure(show.ahead), "Error of the predicted position over the horizon, 95 % intervals")
        )
    if show.piece is not None:
        name = show.piece.recording
        drawings.append(drawing(piece_figure(show.piece), f"{name}: the stretch that the baseline predicts worst"))
        drawings.append(drawing(error_figure(show.piece, show.floor_m), f"{name}: error of the same predictions"))
    if not drawings:
        return untested("no flight is long enough to predict 20 ms ahead")
    head = [
        "ahead",
        "baseline [µm]",
        "extended [µm]",
        "noise floor [µm]",
        "extended / baseline",
        "excess removed",
        "samples",
    ]
    rows = [
        [
            f"{one.horizon_s * 1e3:.3g} ms",
            f"{one.baseline.value * 1e6:.3g} ({one.baseline.low * 1e6:.3g} .. {one.baseline.high * 1e6:.3g})",
            f"{one.extended.value * 1e6:.3g} ({one.extended.low * 1e6:.3g} .. {one.extended.high * 1e6:.3g})",
            f"{one.floor_m * 1e6:.3g}",
            f"{one.ratio[0]:.3f} .. {one.ratio[1]:.3f}",
            _removed(one.removed, one.baseline.value, one.floor_m),
            f"{one.count}",
        ]
        for one in show.ahead
    ]
    if found.before == found.after:
        head = ["ahead", "error [µm]", "noise floor [µm]", "samples"]
        rows = [[row[0], row[1], row[3], row[6]] for row in rows]
    text = (
        "Root mean square of predicted - measured position, each prediction from the readings up to so many "
        "milliseconds before and the measured input since. Intervals: 95 %, bootstrap over blocks of half a second. "
        "The floor is what sensor noise alone leaves of a right model; removed: share of the mean square above it. "
        f"The ball is unstable: in the middle of its travel an error grows by e every {_growth_s(found) * 1e3:.0f} ms, "
        "so that small causes show at long horizons."
    )
    return figures(drawings) + table(head, rows) + paragraph(text) + _worse(found, show) + _cost(found)


def _growth_s(found: Diagnosis) -> float:
    """Time constant of the unstable pole of (6) in the middle of the travel, s: sqrt(gap / 2 g)."""
    plant = found.baseline.plant
    return math.sqrt((plant.x_max_m - 0.5 * plant.travel_m) / (2.0 * plant.gravity_m_s2))


def _removed(share: float, baseline_m: float, floor_m: float) -> str:
    if not math.isfinite(share) or baseline_m < 1.02 * floor_m:
        return "nothing to remove"
    return f"{100 * share:.3g} %"


def _worse(found: Diagnosis, show: Show) -> str:
    if found.before == found.after:
        return ""
    worse = [f"{one.horizon_s * 1e3:.3g} ms ahead" for one in show.ahead if one.ratio[0] > 1.0] + show.worse()
    if not worse:
        return "<p>Nothing got worse: no horizon and no group below has a surely larger error (99.5 %).</p>"
    return '<p class="no">What got worse:</p>' + bullets(worse)


def _cost(found: Diagnosis) -> str:
    count = sum(len(cause.parameters) for cause in found.extended.causes)
    if not count:
        return ""
    gain = found.selection.fit.loglik - found.selection.base.loglik
    return paragraph(
        f"The price: {count} parameter{'s' if count > 1 else ''} more, for {gain:.0f} of log-likelihood on the "
        "recordings that were fitted; by chance each would bring about half of one."
    )


def _where(found: Diagnosis, show: Show) -> str:
    regimes = [one for one in show.regimes if not found.quick or one.name in _QUICK_REGIMES]
    drawings = [drawing(regime_figure(one, show.floor_m), f"Error 20 ms ahead by {one.title}") for one in regimes]
    if show.spectrum is not None and not found.quick:
        caption = (
            f"Spectrum of the error one sample ahead ({show.spectrum.segments} segments); noise alone is a flat line"
        )
        drawings.append(drawing(spectrum_figure(show.spectrum), caption))
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
                [drawing(curve_figure(one), f"{captions[one.residual_unit]}, over {one.title}") for one in residuals]
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
        drawing(steps_figure(steps), f"Mean of {steps.count} reference steps, each as a share of itself"),
        drawing(step_difference_figure(steps), "Rig minus simulation"),
    ]
    rows, pace = [], ""
    for first, second in steps.figures:
        if first.name not in _STEP_FIGURES or not first.count:
            continue
        title, unit, factor = FIGURES[first.name]
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


def _left(found: Diagnosis, show: Show) -> str:
    parts = []
    if found.verdict == "unknown-cause":
        text = f"Of what the baseline lacks, {100 * found.unexplained_share:.0f} % is left, and it is no sensor noise."
        if found.unexplained_where:
            text += f" It is largest {_lower(found.unexplained_where)}."
        parts.append(paragraph(text))
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
                "What is left is as white as noise; against sensor noise alone "
                f"{percent(found.unexplained_share)} of what the baseline lacks is still missing."
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
            + figures([drawing(correction_figure(one), "For prediction only, not a cause")])
            + paragraph(
                "For prediction only, not a cause: the mean error 20 ms ahead over position and speed, learnt on the "
                "recordings for fitting, is taken off the prediction. " + f"{verdict}: {gain}."
            )
        )
    return "".join(parts)


def _lower(text: str) -> str:
    return text.removeprefix("most ")


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


def _numbers(found: Diagnosis) -> str:
    rows = []
    first, second = found.baseline.parameters, found.extended.parameters
    for name, after in second.items():
        before = first.get(name)
        rows.append([f"{name} {_of(after)}", _value(before) if before else "-", _value(after)])
    for cause in found.extended.causes:
        known = BY_NAME[cause.name]
        for entry in known.parameters:
            parameter = cause.parameters[entry.name]
            rows.append([html.escape(f"{entry.symbol} of {cause.name}"), "-", _value(parameter)])
    noise = [
        ("noise of x", found.before.sigma_x_m, found.after.sigma_x_m, "m"),
        ("noise of i_c", found.before.sigma_i_c_a, found.after.sigma_i_c_a, "A"),
        ("acceleration left to chance", found.before.process_a_m_s2, found.after.process_a_m_s2, "m/s^2"),
        ("current left to chance", found.before.process_i_c_a, found.after.process_i_c_a, "A"),
    ]
    rows += [[name, quantity(a, unit), quantity(b, unit)] for name, a, b, unit in noise]
    head = ["", "baseline", "extended"]
    if found.before == found.after:
        head, rows = ["", "model"], [[row[0], row[2]] for row in rows]
    return table(head, rows) + paragraph(
        "In brackets 95 % intervals of maximum likelihood, where they were computed. Sensor noise of the ball at rest: "
        f"{quantity(found.floor.sigma_x_m, 'm')} and {quantity(found.floor.sigma_i_c_a, 'A')}"
        + ("." if found.floor.measured else ", taken from the fit: it never rested long enough.")
    )


def _of(parameter: Parameter) -> str:
    return f"of {html.escape(parameter.equation)}" if parameter.equation else ""


def _value(parameter: Parameter) -> str:
    number, interval = measured(parameter.value, parameter.ci95, parameter.unit)
    return html.escape(f"{number} ({interval})" if interval else number)


def _use(found: Diagnosis) -> str:
    rows = [[*_usage(usage), "fit"] for usage in found.fit_evidence.usages]
    if found.judge_evidence is not None:
        rows += [[*_usage(usage), "judge"] for usage in found.judge_evidence.usages]
    head = [
        "recording",
        "kind",
        "samples",
        "in flight",
        "flights",
        "at a stop",
        "gaps",
        "clipped",
        "outliers",
        "25 kHz",
        "use",
    ]
    notes = bullets(found.warnings) if found.warnings else ""
    times = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in found.stages_s.items())
    points = len(found.fit_evidence.statics)
    return (
        table(head, rows)
        + (paragraph(f"Beside these, {points} points of force balance (lift-off, equilibria).") if points else "")
        + notes
        + paragraph(f"Time: {times}; together {sum(found.stages_s.values()):.1f} s.")
    )


def _usage(usage: Usage) -> list[str]:
    numbers: Sequence[int] = (
        usage.samples,
        usage.flight_samples,
        usage.flights,
        usage.contact_samples,
        usage.gaps,
        usage.clipped + usage.cut,
        usage.outliers,
        usage.captures,
    )
    return [html.escape(usage.name), usage.kind, *(str(number) for number in numbers)]


def _again(found: Diagnosis, campaign: Path, out: Path) -> str:
    judge = found.judge_evidence
    flown = [record for record in judge.records if record.has("x")] if judge is not None else []
    name = flown[0].name if flown else "RECORDING"
    samples = max(round(HORIZON_S / found.tick_s), 1)
    folder = campaign if campaign.suffix != ".toml" else campaign.parent
    quick = " --quick" if found.quick else ""
    model = out / "extended_model.json"
    lines = [
        f"board51 diagnose {campaign}{quick} --out {out}",
        f"board51 predict {model} {folder / name} --campaign {campaign} --horizon {samples} --out pred.csv",
        f"board51 validate {campaign} --model {model} --out validation",
    ]
    return f"<pre>{html.escape(chr(10).join(lines))}</pre>" + paragraph(
        "pred.csv has t, x, x_hat: the error above is their root mean square difference. diagnosis.json beside this "
        "page has every number of it."
    )
