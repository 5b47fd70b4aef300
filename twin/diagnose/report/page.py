"""The report of a diagnosis: one HTML page that needs nothing else.

The sentence, before and after, where the simulation is wrong, which cause and why, what to do, what is left, and how
to compute it again.

Rule 1: every number is that of diagnosis.json, or of `twin/diagnose/residuals/summary.py`; nothing is estimated here.
Rule 2: a page of a model that is adequate, or of a cause that nobody knows, says what was looked at all the same.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

from twin.diagnose.inference.budget import millions
from twin.diagnose.report.figures import (
    ahead_figure,
    drawn,
    error_figure,
    piece_figure,
)
from twin.diagnose.report.page_causes import causes, not_the_cause, ranking
from twin.diagnose.report.page_errors import left, where
from twin.diagnose.report.page_noise import instruments
from twin.diagnose.report.sentences import measured, quantity
from twin.diagnose.residuals.regimes import Estimate
from twin.diagnose.residuals.summary import HORIZON_S, Show
from twin.diagnose.result import Diagnosis
from twin.estimation.prepare import Usage
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Parameter
from twin.page import bullets, figures, paragraph, table, untested, whole

_COLOUR = {
    "causes-found": "found",
    "partly-explained": "warn",
    "model-adequate": "pass",
    "unknown-cause": "fail",
    "unfinished": "fail",
}


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
        where(found, show),
        "<h2>Which cause</h2>",
        ranking(found),
    ]
    if found.causes:
        held = any(found.holds(cause) for cause in found.causes)
        head = "The causes, and what to do" if held else "Candidates: none of them is sure to be a cause"
        body += [f"<h2>{head}</h2>", causes(found)]
    body += [
        "<h2>What is left</h2>",
        left(found, show),
        "<h2>The model's numbers</h2>",
        _numbers(found),
        instruments(found),
        "<h2>What was not named</h2>",
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
            "Made with --quick: the confidence figures are not calibrated, and confounders were not searched for."
        )
    if found.budget.unanswered:
        rest = "; ".join(found.budget.unanswered)
        lines.append(f"The budget of {millions(found.budget.limit)} ended first. Not examined: {rest}.")
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
        text += f" Confidence that the name, or one of its class, is right: {sure}."
    return text


def _before_after(found: Diagnosis, show: Show) -> str:
    drawings = []
    if show.ahead:
        drawings.append(
            drawn(ahead_figure(show.ahead), "Error of the predicted position over the horizon, 95 % intervals")
        )
    if show.piece is not None:
        name = show.piece.recording
        drawings.append(drawn(piece_figure(show.piece), f"{name}: the stretch that the baseline predicts worst"))
        drawings.append(drawn(error_figure(show.piece, show.floor_m), f"{name}: error of the same predictions"))
    if not drawings:
        return untested("no flight is long enough to predict 20 ms ahead")
    head = [
        "ahead",
        "baseline [µm]",
        "extended [µm]",
        "noise floor [µm]",
        "extended / baseline",
        "of its square above the floor removed",
        "samples",
    ]
    rows = [
        [
            f"{one.horizon_s * 1e3:.3g} ms",
            _spread(one.baseline),
            _spread(one.extended),
            _micro(one.floor_m),
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
        "so that small causes show at long horizons. No prediction is taken farther than a quarter of the travel "
        "behind a stop: a ball does not go there."
    )
    return figures(drawings) + table(head, rows) + paragraph(text) + _worse(found, show) + _cost(found)


def _micro(value_m: float) -> str:
    """In micrometres, never with an exponent."""
    micro = value_m * 1e6
    return f"{micro:.0f}" if micro >= 1e3 else f"{micro:.3g}"


def _spread(error: Estimate) -> str:
    return f"{_micro(error.value)} ({_micro(error.low)} .. {_micro(error.high)})"


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
