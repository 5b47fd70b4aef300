"""The forecast as JSON, as text and as an HTML page that needs nothing else."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twin.page.figures import EXTENDED, MEASURED, MODEL, REFERENCE, grid, inline, legend_above, styled
from twin.page.plain import columns, plain
from twin.page.render import Mark, render
from twin.what_if.forecast import ALL_FIGURES, Expected, Forecast, first_change

WINDOW_S = 4.0


def to_dict(result: Forecast) -> dict[str, Any]:
    """The numbers in SI units without the traces; NaN becomes None."""
    parts = {name: value for name, value in asdict(result).items() if not isinstance(value, np.ndarray)}
    return plain({"answer": result.answer(), **parts})


def to_csv(result: Forecast) -> str:
    """The traces: t, x_ref, then the quantiles 2.5, 50 and 97.5 % of x (m) and u_c (V)."""
    header = "t,x_ref,x_low,x,x_high,u_c_low,u_c,u_c_high"
    rows = np.column_stack([result.t_s, result.x_ref_m, *result.x_m, *result.u_v])
    return "\n".join([header, *(",".join(f"{value:.9g}" for value in row) for row in rows)]) + "\n"


def to_text(result: Forecast) -> str:
    """The answer, then the figures as lines of text."""
    rows: list[list[str | Mark]] = [[*_head(result)], *(_row(figure, result) for figure in result.figures)]
    return "\n".join([result.answer(), "", *columns(rows)])


def to_html(result: Forecast) -> str:
    """The page."""
    flies = result.lost < result.draws
    return render(
        "what_if/report.html",
        title=f"What if: {result.recording} under another law",
        answer=result.answer(),
        colour="fail" if result.lost else "found",
        result=result,
        picture=inline(forecast_figure(result), "recorded and expected position and input") if flies else None,
        head=_head(result),
        figures=[_row(figure, result) for figure in result.figures] if flies else [],
    )


@styled
def forecast_figure(result: Forecast) -> Figure:
    """Draw position and input, recorded and expected, around the first change of the reference."""
    first = max(first_change(result.x_ref_m) - 50, 0)
    part = slice(first, first + int(np.searchsorted(result.t_s - result.t_s[0], WINDOW_S)))
    t = result.t_s[part]
    figure, axes = grid(2, 1, height=6.4, ratios=[1.8, 1.0])
    top, bottom = axes[0][0], axes[1][0]
    sides = (
        (top, result.recorded_x_m, result.x_m, result.flown_x_m, 1e3),
        (bottom, result.recorded_u_v, result.u_v, result.flown_u_v, 1.0),
    )
    for ax, recorded, (low, middle, high), flown, factor in sides:
        if len(recorded):
            ax.plot(t, recorded[part] * factor, color=MEASURED, lw=0.9, label="recorded, law as flown")
        ends = (low[part] * factor, high[part] * factor)
        ax.fill_between(t, *ends, color=EXTENDED, alpha=0.3, lw=0, label="95 % of draws")
        ax.plot(t, middle[part] * factor, color=EXTENDED, lw=1.4, ls="--", label="expected, median")
        if len(flown):
            ax.plot(t, flown[part] * factor, color=MODEL, lw=0.9, label="flown then")
    top.plot(t, result.x_ref_m[part] * 1e3, color=REFERENCE, lw=0.9, ls=":", label="reference")
    top.set_ylabel("position x [mm]")
    legend_above(top)
    bottom.set(xlabel="time [s]", ylabel="input u_c [V]")
    return figure


def _head(result: Forecast) -> list[str]:
    return ["", "recorded", "expected", "95 % interval", "", *(["flown then"] if len(result.flown_x_m) else [])]


def _row(figure: Expected, result: Forecast) -> list[str | Mark]:
    cells = _forecast_row(figure)
    if not len(result.flown_x_m):
        return cells
    if not math.isfinite(figure.flown):
        return [*cells, "-"]
    _, _, factor = ALL_FIGURES[figure.name]
    return [*cells, f"{figure.flown * factor:.4g}{' (outside)' if figure.draws and not figure.held else ''}"]


def _forecast_row(figure: Expected) -> list[str | Mark]:
    title, unit, factor = ALL_FIGURES[figure.name]
    cells: list[str | Mark] = [f"{title} [{unit}]"]
    known = math.isfinite(figure.recorded)
    cells.append(f"{figure.recorded * factor:.4g}" if known else "-")
    if not figure.draws:
        return [*cells, "-", "-", "not in every step"]
    low, high = figure.ci95
    cells += [f"{figure.value * factor:.4g}", f"{low * factor:.4g} .. {high * factor:.4g}"]
    if not known:
        return [*cells, ""]
    return [*cells, "no difference" if low <= figure.recorded <= high else "differs"]
