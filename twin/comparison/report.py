"""The comparison as JSON, as text and as an HTML page that needs nothing else."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from twin.comparison import figures
from twin.comparison.comparison import Comparison
from twin.comparison.errors import WHOLE, Change
from twin.comparison.parameters import Course
from twin.distributions import Z_95
from twin.page.figures import Picture, inline
from twin.page.plain import columns, micrometres, plain
from twin.page.render import Mark, render

TITLES = {
    "models": "Two models on the same flights",
    "flights": "Two flights under one model",
    "time": "Models over time",
}
ERROR_HEAD = ("ahead", "where", "first [µm]", "second [µm]", "second / first", "95 % interval", "predictions", "")


def to_dict(result: Comparison) -> dict[str, Any]:
    """The numbers in SI units; NaN becomes None."""
    return plain({"answer": result.answer(), **asdict(result)})


def to_text(result: Comparison) -> str:
    """The answer, then the tables as lines of text."""
    lines = [result.answer(), ""]
    sides = [f"{name}  {day}".rstrip() for name, day in zip(result.names, result.days, strict=True)]
    lines += [f"{n + 1}: {side}" for n, side in enumerate(sides)]
    if result.flights and result.kind == "models":
        lines.append(f"on {', '.join(result.flights)}")
    if result.changes:
        lines += ["", *columns([ERROR_HEAD, *map(_error_row, result.changes)])]
    if result.parameters:
        rows = [_parameter_row(course, result.kind) for course in result.parameters]
        lines += ["", *columns([_parameter_head(result), *rows])]
    return "\n".join(lines)


def to_html(result: Comparison) -> str:
    """The page."""
    return render(
        "comparison/report.html",
        title=TITLES[result.kind],
        answer=result.answer(),
        colour="found" if result.differs else "",
        result=result,
        sides=list(zip(result.names, result.days, strict=True)),
        pictures=_pictures(result),
        error_head=ERROR_HEAD,
        errors=[_error_row(change) for change in result.changes],
        parameter_head=_parameter_head(result),
        parameters=[_parameter_row(course, result.kind) for course in result.parameters],
    )


def _pictures(result: Comparison) -> dict[str, Picture]:
    drawn = {}
    whole = [change for change in result.changes if change.region == WHOLE and math.isfinite(change.ratio)]
    if len(whole) > 1:  # of one horizon the table says all
        drawn["errors"] = inline(figures.error_figure(whole, result.names), "errors over the horizon")
    testable = [course for course in result.parameters if math.isfinite(course.chance)]
    if result.kind == "time" and testable:
        drawn["courses"] = inline(figures.course_figure(testable, result.days, result.names), "parameters over time")
    return drawn


def _error_row(change: Change) -> list[str | Mark]:
    known = math.isfinite(change.chance)
    return [
        f"{change.horizon_s * 1e3:.3g} ms",
        change.region,
        _micro(change.first_m),
        _micro(change.second_m),
        f"{change.ratio:.3f}" if math.isfinite(change.ratio) else "-",
        f"{change.ci95[0]:.3f} .. {change.ci95[1]:.3f}" if known else "-",
        f"{change.count}",
        _verdict(change) if known else "too few data" if change.count else "none",
    ]


def _verdict(change: Change) -> str | Mark:
    if not change.significant:
        return "no difference"
    return Mark("second smaller" if change.ratio < 1.0 else "second larger", change.ratio < 1.0)


def _micro(value_m: float) -> str:
    return micrometres(value_m) if math.isfinite(value_m) else "-"


def _parameter_head(result: Comparison) -> list[str]:
    return ["", *(f"{n + 1}" for n in range(len(result.names))), "last against first", "95 % interval", ""]


def _parameter_row(course: Course, kind: str) -> list[str | Mark]:
    cells: list[str | Mark] = [f"{course.name} [{course.unit or '-'}]"]
    for value, std in zip(course.values, course.stds, strict=True):
        spread = f" ± {Z_95 * std:.2g}" if math.isfinite(std) else ""
        cells.append(f"{value:.5g}{spread}" if math.isfinite(value) else "-")
    if not math.isfinite(course.chance):
        return [*cells, "-", "-", "not testable"]
    low, high = (f"{100.0 * end:+.3g}" for end in course.change_ci95)
    verdict = Mark("changed" if kind == "time" else "differs", good=False) if course.significant else "no difference"
    return [*cells, f"{100.0 * course.change:+.3g} %", f"{low} .. {high} %", verdict]
