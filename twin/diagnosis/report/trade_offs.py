"""Parameters that trade off, in words and as a picture."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twin.diagnosis.report.figures import panel
from twin.diagnosis.report.quantities import quantity, scale_of
from twin.distributions import Z_95
from twin.inference.theta import parameter_of
from twin.inference.trade_offs import END_DROP, TradeOff
from twin.model.parameters import PARAMETERS
from twin.page.figures import EXTENDED, MEASURED, inline, label, styled


def trade_off_cards(pairs: tuple[TradeOff, ...]) -> list[dict[str, Any]]:
    """Return the fields of the template for each pair."""
    return [
        {"sentences": trade_off_sentences(pair), "picture": inline(_figure(pair), _caption(pair))} for pair in pairs
    ]


def trade_off_sentences(pair: TradeOff) -> list[str]:
    """Say which change of both the recordings do not show, and which combination they determine."""
    a, b = map(symbol_of, pair.names)
    change_a, change_b = (_change(pair, k) for k in (0, 1))
    direction = "larger" if pair.correlation > 0.0 else "smaller"
    return [
        f"{a} and {b} trade off (correlation {pair.correlation:.3f}).",
        f"{b} larger by {change_b} with {a} {direction} by {change_a} explains the recordings almost as well.",
        *_combination(pair, a, b),
        f"With one of them measured by other means, the interval of the other is {pair.narrowing:.2g} times narrower.",
    ]


def _combination(pair: TradeOff, a: str, b: str) -> list[str]:
    if pair.weights is None:
        return []
    first, second = pair.weights
    sign = "+" if second >= 0.0 else "\N{MINUS SIGN}"
    return [f"In relative changes, these data determine {first:.2f} {a} {sign} {abs(second):.2f} {b}."]


def _caption(pair: TradeOff) -> str:
    low, high = pair.drops
    text = (
        "95 % region of both. At the ends of the long axis the log-likelihood is "
        f"{low:.1f} and {high:.1f} lower; {END_DROP:.1f} makes the region an ellipse"
    )
    return text if pair.parabolic else f"{text}. The true region is not an ellipse"


@styled
def _figure(pair: TradeOff) -> Figure:
    figure, ax = panel()
    axes = []
    for name, column in zip(pair.names, (0, 1), strict=True):
        factor, unit = _axis_scale(float(np.max(np.abs(pair.contour[:, column]))), _unit(name))
        axes.append(
            (pair.contour[:, column] / factor, pair.values[column] / factor, f"{symbol_of(name)} [{unit or '-'}]")
        )
    (y, y_best, y_label), (x, x_best, x_label) = axes
    ax.fill(x, y, color=EXTENDED, alpha=0.2, lw=0)
    ax.plot(x, y, color=EXTENDED, lw=1.2, label="95 % region")
    ax.plot([x_best], [y_best], color=MEASURED, marker="o", ls="", ms=5, label="best fit")
    label(ax, x_label, y_label)
    return figure


def _axis_scale(largest: float, unit: str) -> tuple[float, str]:
    """Return (factor, unit) of an axis: with a prefix where the unit takes one, else with a power of ten."""
    factor, scaled_unit = scale_of(largest, unit)
    if factor != 1.0 or 0.01 <= largest < 1e4:
        return factor, scaled_unit
    power = 3 * math.floor(math.log10(largest) / 3.0)
    return 10.0**power, f"10$^{{{power}}}$ {unit}"


def _change(pair: TradeOff, k: int) -> str:
    """Return the half width of the 95 % interval of one of them, in percent where it is one of the paper's."""
    half, name = Z_95 * pair.stds[k], pair.names[k]
    return quantity(half, _unit(name)) if "." in name else f"{100.0 * half / pair.values[k]:.2g} %"


def symbol_of(name: str) -> str:
    """The symbol of a coordinate: K_c, or that of a parameter with its cause."""
    return f"{parameter_of(name).symbol} of {name.partition('.')[0]}" if "." in name else name


def _unit(name: str) -> str:
    return parameter_of(name).unit if "." in name else PARAMETERS[name][0]
