"""The part of the report that shows where the simulation is wrong, and what of it is left."""

from __future__ import annotations

import math
from typing import Any

from twin.diagnosis.report import figures
from twin.diagnosis.report.quantities import percent, quantity
from twin.diagnosis.report.sentences import LACKED, ON_JUDGES, capital
from twin.diagnosis.residuals.force import Curve
from twin.diagnosis.residuals.step_response import Steps
from twin.diagnosis.residuals.summary import Summary
from twin.diagnosis.result import Diagnosis
from twin.estimation.step_figures import FIGURES, definition
from twin.page.figures import inline

_QUICK_REGIMES = ("position", "speed")
_MISSING = {"N": "Unexplained force", "A": "Unexplained current, one sample ahead"}
_UNEXPLAINED = ("unknown-cause", "partly-explained")
_STEP_FIGURES = ("rise_s", "settling_s", "overshoot")


def errors(diagnosis: Diagnosis, summary: Summary) -> dict[str, Any]:
    """Return the fields of page_errors.html."""
    unchanged = diagnosis.before == diagnosis.after
    regimes = [entry for entry in summary.regimes if not diagnosis.quick or entry.name in _QUICK_REGIMES]
    group_pictures = [
        inline(figures.regime_figure(entry, summary.floor_m), f"Error 20 ms ahead by {entry.title}")
        for entry in regimes
    ]
    if summary.spectrum is not None and not diagnosis.quick:
        caption = f"Spectrum of the error one sample ahead ({summary.spectrum.segments} segments);"
        caption += " noise alone is a flat line"
        group_pictures.append(inline(figures.spectrum_figure(summary.spectrum), caption))
    curves = [*summary.force, *(() if diagnosis.quick else summary.current)]
    charts = [entry for entry in curves if len(entry.points) > 1]
    steps = summary.steps
    return {
        "by_group": group_pictures,
        "lines": [f"{capital(line.sentence)}." for line in diagnosis.lines],
        "steps": steps,
        "fitted": len(diagnosis.fit_evidence.records),
        "step_pictures": []
        if isinstance(steps, str)
        else [
            inline(figures.steps_figure(steps), f"Mean of {steps.count} reference steps, each as a share of itself"),
            inline(figures.step_difference_figure(steps), "Rig minus simulation"),
        ],
        "step_rows": [] if isinstance(steps, str) else _step_rows(steps, unchanged),
        "pace": "" if isinstance(steps, str) else _pace(steps, unchanged),
        "differing_figures": "" if isinstance(steps, str) or unchanged else differing_figures(steps),
        "residuals": [
            inline(figures.curve_figure(entry), f"{_MISSING[entry.residual_unit]}, over {entry.title}")
            for entry in charts
        ],
        "single": [_single(entry) for entry in curves if len(entry.points) == 1],
        "rest": _rest(diagnosis) if diagnosis.verdict in _UNEXPLAINED else "",
        "largest": _largest(summary) if diagnosis.verdict in _UNEXPLAINED else [],
    }


def _step_rows(steps: Steps, unchanged: bool) -> list[list[str]]:
    rows = []
    for first, second in steps.figures:
        if first.name not in _STEP_FIGURES or not first.count:
            continue
        _, unit, factor = FIGURES[first.name]
        title = definition(first.name, first.bands)
        cells = [f"{title} [{unit}]", f"{first.rig * factor:.4g}", f"{first.simulation * factor:.4g}"]
        for compared in (first,) if unchanged else (first, second):
            ends = compared.ci95 or (math.nan, math.nan)
            cells.append(f"{compared.difference * factor:+.3g} ({ends[0] * factor:+.3g} .. {ends[1] * factor:+.3g})")
        if not unchanged:
            cells.insert(3, f"{second.simulation * factor:.4g}")
        rows.append([*cells, f"{first.count} of {first.steps}"])
    return rows


def _pace(steps: Steps, unchanged: bool) -> str:
    """Say whether rig or simulation rises faster; empty if the interval does not decide."""
    first, second = next((pair for pair in steps.figures if pair[0].name == "rise_s"), (None, None))
    if first is None or second is None or not first.count or first.ci95 is None:
        return ""
    low, high = first.ci95
    same = "the simulation" if unchanged else "the baseline simulation"
    left = not unchanged and second.significant
    if not first.significant:
        text = f"The rig is as fast as {same}, within {max(abs(low), abs(high)) * 1e3:.2g} ms."
        return text + f" The extended model is off by {abs(second.difference) * 1e3:.2g} ms." * left
    slower = "slower" if first.difference > 0.0 else "faster"
    text = (
        f"The rig is {slower} than {same}: {abs(first.difference) * 1e3:.2g} ms of {first.rig * 1e3:.3g} ms rise time."
    )
    if unchanged or second.ci95 is None:
        return text
    rest = "The extended model does not explain all of it." if left else "The extended model is as fast as the rig."
    return f"{text} {rest}"


def differing_figures(steps: Steps) -> str:
    """Name the figures of a step in which extended model and rig differ significantly; empty if none."""
    rows = [second for _, second in steps.figures]
    return " and ".join(FIGURES[row.name][0] for row in rows if row.significant and row.name in _STEP_FIGURES)


def _single(curve: Curve) -> str:
    """A curve of one point, as a sentence: a chart of it shows nothing."""
    (point,) = curve.points
    sides = [("baseline", point.baseline), ("extended", point.extended)]
    if point.baseline == point.extended:
        sides = [("model", point.baseline)]
    values = ", ".join(
        f"{name} {quantity(estimate.value, curve.residual_unit)} "
        f"({quantity(estimate.low, curve.residual_unit)} to {quantity(estimate.high, curve.residual_unit)})"
        for name, estimate in sides
    )
    at = quantity(point.at, curve.unit)
    return f"{_MISSING[curve.residual_unit]}, over {curve.title}: one group alone, at {at}: {values}."


def _rest(diagnosis: Diagnosis) -> str:
    """Say how much is left, and in which quantity."""
    if diagnosis.unexplained_where.startswith(ON_JUDGES):
        return (
            "Nothing measurable is left of the recordings for fitting, but not everything is explained "
            f"{diagnosis.unexplained_where}."
        )
    share = percent(diagnosis.account.unexplained)
    text = f"{capital(share)} of {LACKED} on the recordings for fitting is left, and it is not sensor noise."
    return text + (
        f" It is largest {diagnosis.unexplained_where.removeprefix('most ')}." * bool(diagnosis.unexplained_where)
    )


def _largest(summary: Summary) -> list[str]:
    """Name for each sorting quantity the group with the largest error, if it stands out."""
    lines = []
    for regime in summary.regimes:
        largest = max(regime.bins, key=lambda bin_: bin_.extended.value)
        smallest = min(regime.bins, key=lambda bin_: bin_.extended.value)
        # Only where the intervals do not overlap: some group is always the largest.
        if largest.extended.low > smallest.extended.high:
            lines.append(
                f"{regime.title}: {largest.label}, {largest.extended.value * 1e6:.3g} µm "
                f"(smallest: {smallest.label}, {smallest.extended.value * 1e6:.3g} µm)"
            )
    return lines
