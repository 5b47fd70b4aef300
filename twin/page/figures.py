"""The style of all figures: colours, grid, font sizes, and how a page embeds a figure.

Rule: measured is blue, a model or a twin red, an extended model green, a reference or a noise floor grey.
"""

from __future__ import annotations

import base64
import functools
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, ParamSpec, TypeVar

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

P = ParamSpec("P")
R = TypeVar("R")
# Their luminances (48, 97 and 131 of 255) differ enough for a print in grey.
MEASURED, MODEL, EXTENDED, REFERENCE, ALARM = "#0b3a5d", "#c8391f", "#4ca561", "#555555", "#b8860b"
_STYLE: Any = {
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 11,
    "figure.dpi": 100,
    "font.size": 11,
    "grid.alpha": 0.3,
    "legend.fontsize": 9.5,
    "path.simplify_threshold": 0.3,
    "savefig.dpi": "figure",
    "svg.fonttype": "path",
    "svg.hashsalt": "board51",
}
_KINDS = {"png": "png", "svg": "svg+xml"}


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure as the templates show it."""

    caption: str
    source: str  # data: URL


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function that draws, so that it draws in this style."""

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return drawn


def grid(
    rows: int, columns: int, *, height: float, width: float = 11.0, ratios: Sequence[float] | None = None
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure and its axes by row and column; a column shares its x axis.  Sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    made = figure.subplots(rows, columns, squeeze=False, sharex="col", height_ratios=ratios)
    return figure, [list(row) for row in made]


def legend_above(ax: Axes) -> None:
    """Put the legend in one line above the axes: inside, it would cover the data of some recordings."""
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=4,
        frameon=False,
        borderaxespad=0.1,
        handlelength=1.4,
        columnspacing=1.0,
        handletextpad=0.5,
    )


def label(ax: Axes, x: str, y: str) -> None:
    """Label both axes, and put the legend above."""
    ax.set(xlabel=x, ylabel=y)
    legend_above(ax)


def ticks_125(ax: Axes, low: float, high: float) -> None:
    """Set ticks of a logarithmic y axis at 1, 2, 5, 10 ... from `low` to `high`; at powers of 10 if it is long."""
    steps = (1, 2, 5) if high / max(low, 1e-12) < 300 else (1,)
    ticks = [m * 10.0**k for k in range(-7, 8) for m in steps if low <= m * 10.0**k <= high]
    ax.set_yticks(ticks, [f"{value:g}" for value in ticks])
    ax.yaxis.set_minor_locator(NullLocator())


@styled
def inline(figure: Figure, caption: str, kind: Literal["png", "svg"] = "svg") -> Picture:
    """Embed a figure in the page; the same numbers give the same bytes."""
    out = io.BytesIO()
    nameless = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
    figure.savefig(out, format=kind, metadata=nameless)
    return Picture(caption, f"data:image/{_KINDS[kind]};base64,{base64.b64encode(out.getvalue()).decode()}")
