"""The input in steps with the ball at rest, then up to its top in pulses of 6 ticks: K_A of eq. (1), and its limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean

from gateway.selftest.bench import Bench, at_input, too_few_states
from gateway.selftest.estimates import Line, line_through
from gateway.selftest.verdict import Verdict, fault, judge

_HOLD_S = 0.05
_TOP_TICKS = 6
_TOP_LEVELS = 3
_ALIVE = 0.05  # of the nominal K_A: below it no current flows
_AMPLIFIER = "look at amplifier, shunt and the calibration of i_c"


@dataclass(slots=True)
class _Levels:
    """Input, V, and mean current, A, of each level."""

    u_v: list[float]
    i_a: list[float]


def staircase(bench: Bench) -> Iterator[Verdict]:
    """Judge the amplifier from input to measured current."""
    bench.open_loop()
    low = _low_levels(bench)
    wrong = _not_followed(bench)
    if wrong is None:
        high = _high_levels(bench)
    bench.idle()
    if wrong is not None:
        yield wrong
        return
    if len(low.u_v) < 5:
        raise too_few_states(len(low.u_v))
    rig = bench.rig
    fitted = line_through(low.u_v[len(low.u_v) // 4 :], low.i_a[len(low.u_v) // 4 :])
    if fitted.slope < _ALIVE * rig.K_A:
        yield fault(
            "no-current", "K_A", f"{fitted.slope:.4f} A/V: i_c does not follow u_c", bound=f"{rig.K_A:.4g} A/V",
            remedy="look at the coil and its wires, its supply, the driver and the shunt",
        )  # fmt: skip
        return
    yield judge(
        "input-gain", "K_A", 1e3 * fitted.slope, "mA/V",
        good=(0.93e3 * rig.K_A, 1.07e3 * rig.K_A), possible=(0.88e3 * rig.K_A, 1.12e3 * rig.K_A),
        remedy=f"{_AMPLIFIER}: i_c or u_c has a wrong scaling, or the coil has another resistance",
    )  # fmt: skip
    yield from _shape(bench, fitted, low, high)


def _low_levels(bench: Bench) -> _Levels:
    count = 8 if bench.quick else 16
    levels = _Levels([], [])
    for n in range(count + 1):
        bench.progress("staircase", n / (count + 4))
        samples = bench.level(bench.rig.rest_input_v * n / count, _HOLD_S)
        if samples:
            levels.u_v.append(bench.scaling.u_v(samples[-1].state.u_c))
            levels.i_a.append(fmean(bench.currents(samples)))
    bench.level(0.0, _HOLD_S)
    return levels


def _not_followed(bench: Bench) -> Verdict | None:
    """Return a fault if u_c in the states is not what was ordered."""
    ordered = bench.input_count(bench.rig.rest_input_v / 2)
    if bench.level(bench.rig.rest_input_v / 2, _HOLD_S):
        bench.level(0.0, _HOLD_S)
        return None
    reported = bench.line.samples[-1].state.u_c
    return fault(
        "input-not-followed", "u_c in the states", f"{reported} counts where {ordered} were ordered",
        remedy="the input converter confirms no write: look at its supply, address and bus",
    )  # fmt: skip


def _high_levels(bench: Bench) -> _Levels:
    rig, levels = bench.rig, _Levels([], [])
    for n in range(1, _TOP_LEVELS + 1):
        u_v = rig.rest_input_v + (rig.top_input_v - rig.rest_input_v) * n / _TOP_LEVELS
        samples = at_input(bench.pulse(u_v, _TOP_TICKS), bench.input_count(u_v))
        if samples:
            levels.u_v.append(bench.scaling.u_v(bench.input_count(u_v)))
            levels.i_a.append(fmean(bench.currents(samples)))
    return levels


def _shape(bench: Bench, fitted: Line, low: _Levels, high: _Levels) -> Iterator[Verdict]:
    rig = bench.rig
    full_a = fitted.slope * rig.rest_input_v
    yield judge(
        "linearity", "largest deviation from a line", 100 * max(abs(r) for r in fitted.residuals) / full_a, "%",
        good=(0.0, 1.0), possible=(0.0, 3.0), remedy=_AMPLIFIER,
    )  # fmt: skip
    good, possible = rig.dead_zone_v
    yield judge(
        "dead-zone", "dead zone", (bench.rest().i_a - fitted.offset) / fitted.slope, "V",
        good=(-good, good), possible=(-possible, possible),
        remedy="look at the threshold of the output stage and at the zero of the input converter",
    )  # fmt: skip
    fall_a = max(0.0, *(a - b for a, b in pairwise(low.i_a)))
    yield judge(
        "monotone", "largest fall of i_c over u_c", 1e3 * fall_a, "mA", good=(0.0, 20 * full_a), remedy=_AMPLIFIER
    )
    if not high.u_v:
        return
    share = 100 * min(i / fitted.at(u) for u, i in zip(high.u_v, high.i_a, strict=True))
    yield judge(
        "saturation", f"i_c up to {high.u_v[-1]:.3g} V, of the line", share, "%",
        good=(96.0, 104.0), possible=(90.0, 110.0),
        remedy="the coil's supply is weak, its current is limited, or i_c is clipped",
    )  # fmt: skip
