"""The part of the report that shows where the simulation is wrong, and what of it is left."""

from __future__ import annotations

import math
from typing import Any

from twin.diagnose.report import figures
from twin.diagnose.report.sentences import LACKED, WHERE_JUDGED, capital, percent, quantity
from twin.diagnose.residuals.force import Curve
from twin.diagnose.residuals.step_response import Steps
from twin.diagnose.residuals.summary import Show
from twin.diagnose.result import Diagnosis
from twin.estimation.step_figures import FIGURES, definition
from twin.page.figures import inline

_QUICK_REGIMES = ("position", "speed")
_MISSING = {"N": "Force that is not explained", "A": "Current that was not foreseen, one sample ahead"}
_UNEXPLAINED = ("unknown-cause", "partly-explained")
_STEP_FIGURES = ("rise_s", "settling_s", "overshoot")


def errors(found: Diagnosis, show: Show) -> dict[str, Any]:
    """What page_errors.html shows."""
    alone = found.before == found.after
    regimes = [one for one in show.regimes if not found.quick or one.name in _QUICK_REGIMES]
    by_group = [
        inline(figures.regime_figure(one, show.floor_m), f"Error 20 ms ahead by {one.title}") for one in regimes
    ]
    if show.spectrum is not None and not found.quick:
        caption = (
            f"Spectrum of the error one sample ahead ({show.spectrum.segments} segments); noise alone is a flat line"
        )
        by_group.append(inline(figures.spectrum_figure(show.spectrum), caption))
    missing = [*show.force, *(() if found.quick else show.current)]
    curves = [one for one in missing if len(one.points) > 1]
    steps = show.steps
    return {
        "by_group": by_group,
        "steps": steps,
        "fitted": len(found.fit_evidence.records),
        "step_pictures": []
        if isinstance(steps, str)
        else [
            inline(figures.steps_figure(steps), f"Mean of {steps.count} reference steps, each as a share of itself"),
            inline(figures.step_difference_figure(steps), "Rig minus simulation"),
        ],
        "step_rows": [] if isinstance(steps, str) else _step_rows(steps, alone),
        "pace": "" if isinstance(steps, str) else _pace(steps, alone),
        "unlike": "" if isinstance(steps, str) or alone else unlike(steps),
        "residuals": [
            inline(figures.curve_figure(one), f"{_MISSING[one.residual_unit]}, over {one.title}") for one in curves
        ],
        "single": [_single(one) for one in missing if len(one.points) == 1],
        "rest": _rest(found) if found.verdict in _UNEXPLAINED else "",
        "largest": _largest(show) if found.verdict in _UNEXPLAINED else [],
    }


def _step_rows(steps: Steps, alone: bool) -> list[list[str]]:
    rows = []
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
    return rows


def _pace(steps: Steps, alone: bool) -> str:
    """Which of the two rises faster; empty where no interval tells."""
    first, second = next((pair for pair in steps.figures if pair[0].name == "rise_s"), (None, None))
    if first is None or second is None or not first.count or first.ci95 is None:
        return ""
    low, high = first.ci95
    same = "the simulation" if alone else "the baseline simulation"
    left = not alone and second.significant
    if not first.significant:
        text = f"The rig is as fast as {same}, within {max(abs(low), abs(high)) * 1e3:.2g} ms."
        return text + f" The extended model is off by {abs(second.difference) * 1e3:.2g} ms." * left
    slower = "slower" if first.difference > 0.0 else "faster"
    text = (
        f"The rig is {slower} than {same}: {abs(first.difference) * 1e3:.2g} ms of {first.rig * 1e3:.3g} ms rise time."
    )
    if alone or second.ci95 is None:
        return text
    rest = "The extended model does not explain all of it." if left else "The extended model is as fast as the rig."
    return f"{text} {rest}"


def unlike(steps: Steps) -> str:
    """In which figures of a step the extended model surely differs from the rig; empty if in none."""
    rows = [second for _, second in steps.figures]
    return " and ".join(FIGURES[row.name][0] for row in rows if row.significant and row.name in _STEP_FIGURES)


def _single(curve: Curve) -> str:
    """A curve of one point, as a sentence: a chart of it shows nothing."""
    (point,) = curve.points
    sides = [("baseline", point.baseline), ("extended", point.extended)]
    if point.baseline == point.extended:
        sides = [("model", point.baseline)]
    values = ", ".join(
        f"{name} {quantity(one.value, curve.residual_unit)} "
        f"({quantity(one.low, curve.residual_unit)} to {quantity(one.high, curve.residual_unit)})"
        for name, one in sides
    )
    at = quantity(point.at, curve.unit)
    return f"{_MISSING[curve.residual_unit]}, over {curve.title}: one group alone, at {at}: {values}."


def _rest(found: Diagnosis) -> str:
    """What is left, and of which quantity."""
    if found.unexplained_where.startswith(WHERE_JUDGED):
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
