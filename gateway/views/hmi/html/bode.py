"""The answer of `board51 bode` as a card: its sentence, and plant and loop gain at each height as pictures.  Pure.

A picture has the measured points with their 95 % intervals, the line of the model and its 95 % band.  Points whose
interval holds no response at all, 0, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gateway.views.hmi.texts import texts_of

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 400.0, 220.0, 50.0, 392.0, 8.0, 180.0
_MARGIN = 1.15  # factor by which the axis of frequencies goes beyond the measured ones
_FACTORS = {"plant": 1e3, "loop": 1.0}  # m/V to mm/V
_SURE = 1.96  # standard deviations of 95 %
_PHASE_STEPS = (5, 10, 15, 30, 45, 90, 180)  # degrees between lines
_MAX_LINES = 6
_Row = tuple[float, float, float, float]  # frequency, value, lower and upper limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """A picture, in units of its view box."""

    title: str  # with the unit of the vertical axis
    grid: list[tuple[float, str]]  # y of each line, and its label
    ticks: list[tuple[float, str]]  # x of each frequency, and its label
    points: list[_Row]  # x, y, and the interval in y
    line: list[_Row]


def bode_card(table: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the parts of a bode.json that the page shows; None where it is none.

    `explains` is None where no flight is excited; `heights` are in mm, each with its pictures.
    """
    try:
        return {
            "answer": str(table["answer"]),
            "explains": table["explains"],
            "heights": [(f"{height['x_m'] * 1e3:.2f}", list(_panels(height))) for height in table["heights"]],
            "notes": [str(note) for note in table["notes"]],
        }
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError):
        return None


def _panels(height: Mapping[str, Any]) -> Iterator[Panel]:
    for name, factor in _FACTORS.items():
        measured, model = height["measured"].get(name), height["model"].get(name)
        if measured is None or model is None:
            continue
        sure = [
            (f, factor * gain, phase, factor * radius)
            for f, gain, phase, radius in _rows(measured, "gain", "phase_deg", "radius95")
            if radius < gain
        ]
        low_hz, high_hz = (sure[0][0] / _MARGIN, sure[-1][0] * _MARGIN) if sure else (math.inf, 0.0)
        curve = [
            (f, factor * gain, phase, spread, phase_std)
            for f, gain, phase, gain_std, phase_std in _rows(
                model, "gain", "phase_deg", "gain_std", "phase_std_deg", exact=2
            )
            if low_hz <= f <= high_hz
            for spread in [math.exp(_SURE * gain_std / gain)]
        ]
        if not curve:
            continue
        gains = [(f, g, g - r, g + r) for f, g, _, r in sure]
        line = [(f, g, g / spread, g * spread) for f, g, _, spread, _ in curve]
        yield _panel(texts_of("bode_gain")[name], gains, line, logarithmic=True)
        turned = _turned([p for _, _, p, _, _ in curve])
        line = [(row[0], p, p - _SURE * row[4], p + _SURE * row[4]) for row, p in zip(curve, turned, strict=True)]
        phases = [(f, _in_turn(line, f, p), math.degrees(math.asin(r / g))) for f, g, p, r in sure]
        bars = [(f, p, p - spread, p + spread) for f, p, spread in phases]
        yield _panel(texts_of("bode_phase")[name], bars, line, logarithmic=False)


def _rows(table: Mapping[str, Any], *names: str, exact: int = 0) -> list[tuple[float, ...]]:
    """Return the finite rows (frequency, and the values of these names), by frequency.

    Of the last `exact` names a missing value is 0: the model states no uncertainty.
    """
    rows = []
    for values in zip(table["f_hz"], *(table[name] for name in names), strict=True):
        head, tail = values[: len(values) - exact], values[len(values) - exact :]
        if None not in head and values[1] > 0.0:
            rows.append(tuple(float(v) for v in (*head, *(v or 0.0 for v in tail))))
    return sorted(rows)


def _turned(phase_deg: Sequence[float]) -> list[float]:
    """Turn a curve so that its middle lies between -270 and 90 degrees: an unstable plant begins at -180."""
    middle = sorted(phase_deg)[len(phase_deg) // 2]
    return [p - 360.0 * math.ceil((middle - 90.0) / 360.0) for p in phase_deg]


def _in_turn(line: Sequence[_Row], f_hz: float, phase_deg: float) -> float:
    """Return a phase in the turn in which the curve is at this frequency."""
    closest = min(line, key=lambda row: abs(math.log(row[0] / f_hz)))[1]
    return phase_deg + 360.0 * round((closest - phase_deg) / 360.0)


def _panel(title: str, points: list[_Row], line: list[_Row], *, logarithmic: bool) -> Panel:
    scale: Callable[[float], float] = math.log10 if logarithmic else float
    drawn = [v for row in points for v in row[2:]] + [v for row in line for v in row[1:]]
    if logarithmic:  # a point that is hardly known must not take the whole height
        drawn = [v for row in points for v in (max(row[2], 0.3 * row[1]), row[3])] + [
            v for row in line for v in row[2:]
        ]
    low, high = scale(min(drawn)), scale(max(drawn))
    margin = max(0.06 * (high - low), 0.02 if logarithmic else 2.0)
    low, high = low - margin, high + margin
    left, right = math.log10(points[0][0] / _MARGIN), math.log10(points[-1][0] * _MARGIN)

    def x(f_hz: float) -> float:
        return LEFT + (math.log10(f_hz) - left) / (right - left) * (RIGHT - LEFT)

    def y(value: float) -> float:
        at = scale(value) if value > 0.0 or not logarithmic else low
        return BOTTOM - (min(max(at, low), high) - low) / (high - low) * (BOTTOM - TOP)

    def placed(rows: list[_Row]) -> list[_Row]:
        return [(x(f), y(v), y(bottom), y(top)) for f, v, bottom, top in rows]

    lines = _decades(low, high) if logarithmic else _steps(low, high)
    return Panel(
        title=title,
        grid=[(y(value), f"{value:g}") for value in lines],
        ticks=[(x(f), f"{f:g}") for f in _decades(left, right)],
        points=placed(points),
        line=placed(line),
    )


def _decades(low: float, high: float) -> list[float]:
    """Return 1, 2, 5, 10 ... between powers of ten, or powers alone where these are many."""
    for digits in ((1, 2, 5), (1,)):
        values = [
            digit * 10.0**k
            for k in range(math.floor(low), math.ceil(high) + 1)
            for digit in digits
            if low <= math.log10(digit * 10.0**k) <= high
        ]
        if len(values) <= _MAX_LINES:
            break
    return values


def _steps(low: float, high: float) -> list[float]:
    step = next((s for s in _PHASE_STEPS if (high - low) / s <= _MAX_LINES), _PHASE_STEPS[-1])
    return [float(k * step) for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
