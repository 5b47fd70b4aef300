"""The prediction error before and after a diagnosis, as a picture: error over horizon, both axes logarithmic.  Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gateway.views.hmi.html.markup import Markup, tag
from gateway.views.hmi.texts import text_of
from protocol.diagnosis import Ahead

_WIDTH, _HEIGHT = 560.0, 260.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 12.0, 14.0, 40.0
_MIN_ERROR_M = 1e-9  # an error of 0 has no logarithm


def errors_figure(ahead: Sequence[Ahead]) -> Markup:
    """The rms error of x on the judge recordings with 95 % intervals: model, extended model, sensor noise alone."""
    values = [max(v, _MIN_ERROR_M) for error in ahead for v in (*error.before, *error.after, error.noise_floor)]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    high = max(high, low + 1)
    first, last = math.log10(ahead[0].horizon_s), math.log10(ahead[-1].horizon_s)
    width = max(last - first, 0.1)

    def x(horizon_s: float) -> float:
        return _LEFT + 24.0 + (math.log10(horizon_s) - first) / width * (_WIDTH - _LEFT - _RIGHT - 48.0)

    def y(error_m: float) -> float:
        share = (math.log10(max(error_m, _MIN_ERROR_M)) - low) / (high - low)
        return _TOP + (1.0 - share) * (_HEIGHT - _TOP - _BOTTOM)

    parts = [_grid(10.0**k, y(10.0**k)) for k in range(low, high + 1)]
    for error in ahead:
        parts.append(_text(x(error.horizon_s), _HEIGHT - 22.0, f"{error.horizon_s * 1e3:.0f}", "middle"))
    parts.append(_text(_LEFT + (_WIDTH - _LEFT) / 2.0, _HEIGHT - 5.0, text_of("figure.horizon"), "middle"))
    parts.append(_path([(x(error.horizon_s), y(error.noise_floor)) for error in ahead], "noise"))
    for name, of in (("before", [error.before for error in ahead]), ("after", [error.after for error in ahead])):
        at = [x(error.horizon_s) for error in ahead]
        parts.append(_path([(a, y(value)) for a, (value, _, _) in zip(at, of, strict=True)], name))
        parts += [_bar(a, y(bottom), y(top), y(value), name) for a, (value, bottom, top) in zip(at, of, strict=True)]
    figure = tag("svg", *parts, viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}", role="img",
                 aria_label=text_of("figure.picture"))  # fmt: skip
    names = (
        ("before", text_of("figure.before")),
        ("after", text_of("figure.after")),
        ("noise", text_of("figure.noise")),
    )
    legend = [tag("span", tag("span", class_=f"mark {name}"), text, class_="entry") for name, text in names]
    caption = tag("figcaption", text_of("figure.caption"), " ", *legend)
    return tag("figure", figure, caption, class_="errors")


def _grid(error_m: float, y: float) -> Markup:
    unit, scale = ("mm", 1e3) if error_m >= 1e-3 else ("\u00b5m", 1e6)
    line = tag("line", x1=_LEFT, x2=_WIDTH - _RIGHT, y1=f"{y:.1f}", y2=f"{y:.1f}", class_="grid")
    return Markup(line + _text(_LEFT - 6.0, y + 4.0, f"{error_m * scale:g} {unit}", "end"))


def _text(x: float, y: float, words: str, anchor: str) -> Markup:
    return tag("text", words, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor)


def _path(points: Sequence[tuple[float, float]], name: str) -> Markup:
    return tag("polyline", points=" ".join(f"{x:.1f},{y:.1f}" for x, y in points), class_=name)


def _bar(x: float, bottom: float, top: float, y: float, name: str) -> Markup:
    bar = tag("line", x1=f"{x:.1f}", x2=f"{x:.1f}", y1=f"{bottom:.1f}", y2=f"{top:.1f}", class_=f"bar {name}")
    return Markup(bar + tag("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=4, class_=name))
