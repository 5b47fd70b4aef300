"""A design as text and as a dictionary."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from twin.control_design.design import Design, LoopAnalysis
from twin.control_design.margins import Margins
from twin.control_design.robust import Robustness
from twin.page.plain import plain

UNITS = {"lqi": ("V/A", "V/m", "V s/m", "V/(m s)"), "pid": ("V/m", "V/(m s)", "V s/m", "-")}
NAMES = {"lqi": ("k_i", "k_x", "k_v", "k_int"), "pid": ("k_p", "k_int", "k_d", "-")}


def controller(design: Design) -> dict[str, Any]:
    """The controller file: the content of SET_GAINS in SI units, and the weights."""
    return {
        "law": design.law,
        "gains": list(design.gains),
        "gain_names": list(NAMES[design.law]),
        "gain_units": list(UNITS[design.law]),
        "operating_point": {"i_0_a": design.point.i_a, "x_0_m": design.point.x_m, "u_0_v": design.point.u_v},
        "sample_time_s": design.sample_time_s,
        "weights": {"Q": list(design.weights.Q), "R": design.weights.R},
        "observer": None
        if design.observer_gain is None
        else {"gain": design.observer_gain.tolist(), "measured": ["i_c", "x"], "runs_on_board": False},
    }


def everything(design: Design) -> dict[str, Any]:
    """The controller with its full analysis; infinite numbers are null."""
    analysis = {
        "on_board": [asdict(gain) for gain in design.quantised],
        "converters": asdict(design.converters),
        "loops": [_loop(loop) for loop in design.loops],
        "before": None if design.before is None else _loop(design.before),
        "stable_range_m": design.stable_range_m,
        "robustness": asdict(design.robustness),
        "observer_robustness": None if design.observer_robustness is None else asdict(design.observer_robustness),
        "stable": design.board.stable,
        "causes": design.causes,
        "warnings": design.warnings,
    }
    return controller(design) | plain(analysis)


def table(design: Design) -> str:
    """The gains, then the analysis, as lines of text."""
    point = design.point
    lines = [
        f"{design.law.upper()} at x = {point.x_m * 1e3:.3f} mm, i_c = {point.i_a:.4f} A, u_c = {point.u_v:.4f} V, "
        f"T_s = {design.sample_time_s * 1e3:g} ms",
        "",
        f"{'gain':<8}{'designed':>12}{'on the board':>14}  {'unit':<10}mantissa * 2^-shift",
    ]
    for name, unit, gain, q in zip(NAMES[design.law], UNITS[design.law], design.gains, design.quantised, strict=True):
        if name != "-":
            lines.append(f"{name:<8}{gain:>12.6g}{q.value:>14.6g}  {unit:<10}{q.mantissa} * 2^-{q.shift}")
    loops = (*design.loops, *([design.before] if design.before is not None else []))
    lines += ["", f"{'':<22}" + "".join(f"{loop.name:>25}" for loop in loops)]
    cells: tuple[tuple[str, Callable[[LoopAnalysis], str]], ...] = (
        ("largest |pole|", lambda loop: f"{abs(loop.poles[0]):.4f}"),
        ("slowest, time const.", lambda loop: _time_constant(loop, design.sample_time_s)),
        ("gain margin, factors", lambda loop: _margin(loop, lambda m: f"{m.gain_low:.2f} .. {m.gain_high:.2f}")),
        ("phase margin", lambda loop: _margin(loop, lambda m: f"{m.phase_deg:.1f} deg")),
        ("delay margin", lambda loop: _margin(loop, lambda m: f"{m.delay_s * 1e3:.2f} ms")),
        ("noise: rms of x", lambda loop: f"{loop.x_rms_m * 1e6:.2f} um"),
        ("   without rounding", lambda loop: f"{loop.x_rms_analog_m * 1e6:.2f} um"),
        ("noise: rms of u_c", lambda loop: f"{loop.u_rms_v * 1e3:.2f} mV"),
        ("   without rounding", lambda loop: f"{loop.u_rms_analog_v * 1e3:.2f} mV"),
    )
    for title, cell in cells:
        lines.append(f"{title:<22}" + "".join(f"{cell(loop):>25}" for loop in loops))
    lines.append("poles")
    lines += [f"  {loop.name:<26}{'  '.join(_pole(p) for p in loop.poles)}" for loop in loops]
    lines += ["", *_costs(design), ""]
    low, high = design.stable_range_m
    if design.board.stable:
        lines.append(f"the board's loop is stable from x = {low * 1e3:.2f} to {high * 1e3:.2f} mm (linearised there)")
    lines.append(f"parameters over their 95 % intervals: {_robustness_text(design.robustness)}")
    if design.observer_robustness is not None:
        lines.append(f"  with the Kalman filter: {_robustness_text(design.observer_robustness)}")
        lines.append("the Kalman filter is for comparison: the board has no observer and cannot run it")
    if design.causes:
        lines += ["", "causes in this model:", *(f"  {line}" for line in design.causes)]
    return "\n".join(lines + [f"! {warning}" for warning in design.warnings])


def _costs(design: Design) -> list[str]:
    ideal, backward, board = design.loops[:3]
    lines = []
    if ideal.margins is not None and backward.margins is not None:
        lines.append(
            f"the backward difference costs {ideal.margins.phase_deg - backward.margins.phase_deg:.1f} deg of phase, "
            f"{(ideal.margins.delay_s - backward.margins.delay_s) * 1e3:.2f} ms of delay margin, "
            f"and noise in u_c times {backward.u_rms_v / ideal.u_rms_v:.1f}"
        )
    if board.stable:
        x = math.sqrt(max(board.x_rms_m**2 - board.x_rms_analog_m**2, 0.0))
        u = math.sqrt(max(board.u_rms_v**2 - board.u_rms_analog_v**2, 0.0))
        lines.append(f"the converters alone cost {x * 1e6:.2f} um rms of x and {u * 1e3:.1f} mV rms of u_c")
    k_v = design.quantised[2].value
    step = k_v * design.converters.x_lsb_m / design.sample_time_s
    lines.append(
        f"one count of x moves u_c by {step * 1e3:.1f} mV through the speed, "
        f"{step / design.converters.u_lsb_v:.0f} counts of u_c"
    )
    return lines


def _robustness_text(box: Robustness) -> str:
    if not box.varied:
        return "not checked, the model has none"
    names = ", ".join(box.varied)
    return (
        f"{names} varied, x_max and mass held: {100 * box.unstable_share:.1f} % of {box.loops} loops unstable, "
        f"worst |pole| {box.worst_pole:.4f}"
    )


def _margin(loop: LoopAnalysis, cell: Callable[[Margins], str]) -> str:
    return "unstable" if loop.margins is None else cell(loop.margins)


def _time_constant(loop: LoopAnalysis, sample_time_s: float) -> str:
    return f"{-sample_time_s / math.log(abs(loop.poles[0])) * 1e3:.0f} ms" if loop.stable else "unstable"


def _pole(p: complex) -> str:
    return f"{p.real:.4f}" if abs(p.imag) < 1e-9 else f"{p.real:.4f}{p.imag:+.4f}j"


def _loop(loop: LoopAnalysis) -> dict[str, Any]:
    m = loop.margins
    return {
        "name": loop.name,
        "stable": loop.stable,
        "poles": [[p.real, p.imag] for p in loop.poles.tolist()],
        "gain_margin": None if m is None else [m.gain_low, m.gain_high],
        "phase_margin_deg": None if m is None else m.phase_deg,
        "delay_margin_s": None if m is None else m.delay_s,
        "x_rms_m": loop.x_rms_m,
        "u_rms_v": loop.u_rms_v,
        "x_rms_without_rounding_m": loop.x_rms_analog_m,
        "u_rms_without_rounding_v": loop.u_rms_analog_v,
    }
