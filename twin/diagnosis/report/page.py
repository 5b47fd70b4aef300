"""The report of a diagnosis: one HTML page that needs nothing else.

The parts are: the sentence; before and after; where the simulation is wrong; which cause and why; what to do; what is
left; how to compute it again.

Rule 1: every number is that of diagnosis.json, or of `twin/diagnosis/residuals/summary.py`; nothing is estimated here.
Rule 2: a page without a named cause also says what was examined.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from twin.diagnosis.judge.account import Verdict
from twin.diagnosis.report import figures
from twin.diagnosis.report.page_causes import causes
from twin.diagnosis.report.page_errors import errors
from twin.diagnosis.report.page_remainder import remainder
from twin.diagnosis.report.quantities import measured, quantity
from twin.diagnosis.report.sentences import capital, sizes
from twin.diagnosis.report.trade_offs import trade_off_cards
from twin.diagnosis.residuals.regimes import Estimate
from twin.diagnosis.residuals.summary import HORIZON_S, Ahead, Summary
from twin.diagnosis.result import Diagnosis, Finding
from twin.estimation.prepare import Usage
from twin.evidence.noise_levels import colours_json, to_json
from twin.inference.budget import millions
from twin.inference.fisher_scoring import Fit
from twin.model.assumed import RESTING, assumption, assumption_warning
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Parameter
from twin.page.figures import Picture, inline
from twin.page.plain import micrometres
from twin.page.render import render

_MAX_NAMES = 3  # recordings by name
_VERDICT: dict[Verdict, str] = {
    "causes-found": "Causes found",
    "partly-explained": "Partly explained",
    "model-adequate": "The model is adequate",
    "unknown-cause": "Unknown cause",
    "unfinished": "Unfinished",
}
_COLOUR = {
    "causes-found": "found",
    "partly-explained": "warn",
    "model-adequate": "pass",
    "unknown-cause": "fail",
    "unfinished": "fail",
}


def to_html(diagnosis: Diagnosis, summary: Summary, *, campaign: Path, out: Path) -> str:
    """The page.

    Args:
        diagnosis: of `diagnose`.
        summary: of `summarise`.
        campaign: as it was given, for the commands at the end.
        out: folder of the page, for the same.
    """
    unchanged = diagnosis.before == diagnosis.after
    rows, over_height = _instruments(diagnosis)
    has_causes = any(diagnosis.holds(cause) for cause in diagnosis.causes)
    return render(
        "diagnosis/report/page.html",
        title=f"What the simulation of {diagnosis.baseline.plant.name} gets wrong",
        answer=diagnosis.headline,
        colour=_COLOUR[diagnosis.verdict],
        verdict=_VERDICT[diagnosis.verdict],
        names=[_row(diagnosis, cause) for cause in diagnosis.causes],
        diagnosis=diagnosis,
        unchanged=unchanged,
        banners=_banners(diagnosis, summary),
        description=_description(diagnosis, campaign),
        pictures=_pictures(summary),
        ahead=[_ahead_row(row, unchanged) for row in summary.ahead],
        growth_ms=f"{_growth_s(diagnosis) * 1e3:.0f}",
        worse=summary.worse(),
        added=_price(sum(len(cause.parameters) for cause in diagnosis.extended.causes)),
        loglik_gain=f"{_extended_fit(diagnosis).loglik - diagnosis.selection.base.loglik:.0f}",
        numbers=[[row[0], row[2]] if unchanged else row for row in _numbers(diagnosis)],
        trade_offs=trade_off_cards(diagnosis.trade_offs),
        floor=_floor(diagnosis),
        instruments=rows,
        over_height=over_height,
        usages=_usages(diagnosis),
        statics=len(diagnosis.fit_evidence.statics),
        stages=_stages(diagnosis.stages_s),
        causes_title="The causes, and what to do" if has_causes else "Candidates: none of them is sure to be a cause",
        commands=_commands(diagnosis, campaign, out),
        **errors(diagnosis, summary),
        **remainder(diagnosis),
        **causes(diagnosis),
    )


def _row(diagnosis: Diagnosis, cause: Finding) -> list[str]:
    """Return the row of a cause in the first box: name, size, confidence, cure."""
    title = cause.name if diagnosis.holds(cause) else f"candidate: {cause.name}"
    cure = BY_NAME[cause.name].cure or "\u2013"
    return [title, sizes(cause.name, cause.parameters), f"{100 * cause.confidence:.0f} %", capital(cure)]


def _banners(diagnosis: Diagnosis, summary: Summary) -> list[str]:
    lines = [assumption_warning(diagnosis.extended.plant)] if diagnosis.extended.plant.assumed else []
    if diagnosis.choice is not None and not diagnosis.choice.compared:
        lines.append("No recording judged the extended model: it may predict worse than the baseline.")
    if diagnosis.quick:
        lines.append(
            "Made with --quick: if there are several causes, few alternatives were tried, and the confidence is not"
            " calibrated."
        )
    if diagnosis.budget.unanswered:
        rest = "; ".join(diagnosis.budget.unanswered)
        lines.append(f"The budget of {millions(diagnosis.budget.limit)} ended first. Not examined: {rest}.")
    if not summary.from_judges:
        lines.append("No recording was left to judge by. The errors below are those of the fit: they are too small.")
    return lines


def _description(diagnosis: Diagnosis, campaign: Path) -> str:
    fit, judge = diagnosis.fit_evidence, diagnosis.judge_evidence
    names = ", ".join(judge.names()) if judge is not None else "none"
    return (
        f"Campaign {campaign.name or campaign}: {len(fit.records)} recordings to fit and to choose causes on, "
        f"judged by {names}. Baseline: {diagnosis.baseline.provenance.get('about', 'the model that was given')}."
    )


def _pictures(summary: Summary) -> list[Picture]:
    drawn = []
    if len(summary.ahead) > 1:  # for one horizon the table suffices
        drawn.append(
            (figures.ahead_figure(summary.ahead), "Error of the predicted position over the horizon, 95 % intervals")
        )
    if summary.piece is not None:
        name = summary.piece.recording
        drawn.append((figures.piece_figure(summary.piece), f"{name}: the stretch that the baseline predicts worst"))
        drawn.append((figures.error_figure(summary.piece, summary.floor_m), f"{name}: error of the same predictions"))
    return [inline(figure, caption) for figure, caption in drawn]


def _ahead_row(horizon: Ahead, unchanged: bool) -> list[str]:
    time_ms = f"{horizon.horizon_s * 1e3:.3g} ms"
    baseline, floor = _with_interval(horizon.baseline), micrometres(horizon.floor_m)
    if unchanged:
        return [time_ms, baseline, floor, f"{horizon.count}"]
    return [
        time_ms,
        baseline,
        _with_interval(horizon.extended),
        floor,
        f"{horizon.ratio[0]:.3f} .. {horizon.ratio[1]:.3f}",
        _removed(horizon.removed, horizon.baseline.value, horizon.floor_m),
        f"{horizon.count}",
    ]


def _with_interval(error: Estimate) -> str:
    value, low, high = map(micrometres, (error.value, error.low, error.high))
    return f"{value} ({low}\N{NO-BREAK SPACE}..\N{NO-BREAK SPACE}{high})"


def _price(count: int) -> str:
    return f"{count} parameter{'s' if count > 1 else ''}" if count else ""


def _extended_fit(diagnosis: Diagnosis) -> Fit:
    """The fit behind extended_model.json."""
    chosen = None if diagnosis.choice is None else diagnosis.choice.fit
    return chosen or diagnosis.selection.fit


def _floor(diagnosis: Diagnosis) -> str:
    at_rest = "" if diagnosis.floor.measured else " (from the fit, because it never rested long enough)"
    return f"{quantity(diagnosis.floor.sigma_x_m, 'm')} and {quantity(diagnosis.floor.sigma_i_c_a, 'A')}{at_rest}."


def _stages(seconds: Mapping[str, float]) -> str:
    text = ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items())
    return f"{text}; together {sum(seconds.values()):.1f} s."


def _growth_s(diagnosis: Diagnosis) -> float:
    """Return the time constant of the unstable pole of (6) in the middle of the travel, s: sqrt(gap / 2 g)."""
    plant = diagnosis.baseline.plant
    return math.sqrt((plant.x_max_m - 0.5 * plant.travel_m) / (2.0 * plant.gravity_m_s2))


def _removed(share: float, baseline_m: float, floor_m: float) -> str:
    if not math.isfinite(share) or baseline_m < 1.02 * floor_m:
        return "nothing to remove"
    return f"{100 * share:.3g} %"


def _numbers(diagnosis: Diagnosis) -> list[list[str]]:
    rows = []
    first, second, plant = diagnosis.baseline.parameters, diagnosis.extended.parameters, diagnosis.extended.plant
    for name, after in second.items():
        before = first.get(name)
        suffix = f", {assumption(plant)}" if plant.assumed and name in RESTING else ""
        equation = f"of {after.equation}" if after.equation else ""
        rows.append([f"{name} {equation}{suffix}", _value(before) if before else "-", _value(after)])
    for cause in diagnosis.extended.causes:
        known = BY_NAME[cause.name]
        for entry in known.parameters:
            parameter = cause.parameters[entry.name]
            rows.append([f"{entry.symbol} of {cause.name}", "-", _value(parameter)])
    noise = [
        ("noise of x", diagnosis.before.sigma_x_m, diagnosis.after.sigma_x_m, "m"),
        ("noise of i_c", diagnosis.before.sigma_i_c_a, diagnosis.after.sigma_i_c_a, "A"),
        ("unexplained acceleration", diagnosis.before.process_a_m_s2, diagnosis.after.process_a_m_s2, "m/s^2"),
        ("unexplained current", diagnosis.before.process_i_c_a, diagnosis.after.process_i_c_a, "A"),
    ]
    rows += [[name, quantity(a, unit), quantity(b, unit)] for name, a, b, unit in noise]
    return rows


def _value(parameter: Parameter) -> str:
    number, interval = measured(parameter.value, parameter.ci95, parameter.unit)
    return f"{number} ({interval})" if interval else number


def _usages(diagnosis: Diagnosis) -> list[list[str]]:
    rows = [[*_usage(usage), "fit"] for usage in diagnosis.fit_evidence.usages]
    judge = diagnosis.judge_evidence
    return rows if judge is None else rows + [[*_usage(usage), "judge"] for usage in judge.usages]


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
    return [usage.name, usage.kind, *(str(number) for number in numbers)]


def _instruments(diagnosis: Diagnosis) -> tuple[list[list[str]], list[str]]:
    """Return (rows of the instruments of each channel, none if each has one; sentences on their noise)."""
    rows: list[list[str]] = []
    sentences: list[str] = []
    noise = diagnosis.fit_evidence.noise
    if noise is None:
        return rows, sentences
    for name, channel in to_json(noise, (diagnosis.floor.sigma_i_c_a, diagnosis.floor.sigma_x_m)).items():
        unit = channel["unit"]
        rows += [
            [
                name,
                _listed(entry["recordings"]),
                "in flight" if entry["in_flight"] else "at rest, captures",
                f"{quantity(entry['sigma'], unit)} ± {100.0 * entry['relative_std']:.2g} %",
            ]
            for entry in channel["instruments"]
        ]
        if channel["over_height"]:
            levels = [
                f"{quantity(entry['sigma'], unit)} at {quantity(entry['x_m'], 'm')}" for entry in channel["over_height"]
            ]
            sentences.append(f"The noise of {name} follows the height: {', '.join(levels)}.")
    for name, colour in colours_json(noise).items():
        sigma, tau = quantity(colour["sigma"], "m" if name == "x" else "A"), quantity(colour["correlation_time_s"], "s")
        white = f"{100.0 * colour['white_share_of_variance']:.2g} %"
        sentences.append(
            f"The noise of {name} at rest is coloured: {sigma}, correlation time {tau}, {white} of it white."
        )
    return rows, sentences


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MAX_NAMES
    return ", ".join(names[:_MAX_NAMES]) + (f" and {more} more" if more > 0 else "")


def _commands(diagnosis: Diagnosis, campaign: Path, out: Path) -> list[str]:
    judge = diagnosis.judge_evidence
    flown = [record for record in judge.records if record.has("x")] if judge is not None else []
    name = flown[0].name if flown else "RECORDING"
    samples = max(round(HORIZON_S / diagnosis.tick_s), 1)
    folder = campaign if campaign.suffix != ".toml" else campaign.parent
    quick = " --quick" if diagnosis.quick else ""
    model = out / "extended_model.json"
    return [
        f"board51 diagnose {campaign}{quick} --out {out}",
        f"board51 predict {model} {folder / name} --campaign {campaign} --horizon {samples} --out pred.csv",
        f"board51 validate {campaign} --model {model} --out validation",
    ]
