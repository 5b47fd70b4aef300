"""Verdicts: each parameter with its interval and verdict, and if not identified, the experiment that would help."""

from __future__ import annotations

import math
from dataclasses import replace

from protocol.campaign import Plant
from twin.distributions import Z_95
from twin.evidence.starting.levels import Levels, Shape
from twin.evidence.starting.liftoff import ForceConstant
from twin.evidence.starting.regression import BallStart
from twin.identification.delays import LoopDelay
from twin.identification.intervals import Interval
from twin.model.parameters import PARAMETERS, Parameter, Verdict
from twin.settings import identification as settings

IDENTIFIED, WEAK = 0.25, 1.0  # half width of the 95 % interval over the value
_HELP = {
    "K_A": "record steps of u_c with two or more steady levels (kind amplifier-step)",
    "T_A": "capture a step of u_c at 25 kHz (board51 send capture; kind amplifier-step)",
    "K_c": "record a slow sawtooth to lift-off (kind sawtooth) or a closed-loop run",
    "b": "record closed loop with wide, fast reference changes (multisine), several minutes: drag shows in speed",
}
_INFINITE = 1e6  # relative width that stands for an infinite one


def gain(joint: Interval | None, levels: Levels | None, shape: Shape | None, warnings: list[str]) -> Parameter:
    """Return K_A from the steady levels, or from the joint fit if it agrees with them; None: there are none.

    `warnings` receives sentences for the user.
    """
    if levels is not None:
        top = max(abs(level.i_a) for level in levels.levels)
        # Two conditions, because with accurate levels even an offset that is too small to matter is significant.
        offset = abs(levels.offset_a) > max(settings.AGREEMENT_ERRORS * levels.offset_std_a, settings.LEVEL_SHARE * top)
        if offset:
            warnings.append(
                f"i_c is {levels.offset_a * 1e3:+.3g} mA at u_c = 0 by the line through the steady levels: an offset "
                f"of sensor or amplifier that (1) lacks. Give i_c offset = {-levels.offset_a:.4g} if it is the sensor's"
            )
        bent = abs(levels.bend_a) > settings.LEVEL_SHARE * top
        if bent:
            warnings.append(
                f"the steady levels do not lie on a line: {levels.bend_a * 1e3:+.3g} mA at {levels.bend_at_v:.3g} V. "
                "A limit, a dead zone or a coil that heats does that; the interval of K_A covers it"
            )
        if shape is not None and not shape.first_order:
            warnings.append(
                f"the amplifier's step response is not first order: its residual is {shape.text} "
                f"({shape.steps} steps); K_A is from the steady levels, T_A the best first-order fit"
            )
        differ = joint is not None and not _agree(levels.K_A, levels.K_A_std, joint)
        # The levels win a disagreement: a transient that is not first order biases the joint fit, but no steady level.
        if joint is None or offset or bent or differ or (shape is not None and not shape.first_order):
            if joint is not None and differ and not offset and not bent:
                warnings.append(
                    f"K_A is {levels.K_A:.5g} A/V by steady levels and {joint.value:.5g} A/V by the joint fit"
                )
            through = f"line through {len(levels.levels)} steady levels"
            return _parameter("K_A", levels.K_A, levels.K_A_std, through, "(1)")
    if joint is None:
        return _absent("K_A", 1.0, warnings)
    how = "steady levels, refined by innovations likelihood" if levels is not None else "innovations likelihood"
    return _parameter("K_A", joint.value, joint, how, "(1), (7)")


def time_constant(joint: Interval | None, shape: Shape | None, tick_s: float, warnings: list[str]) -> Parameter:
    """Return T_A of the joint fit, or of the steps if these are not first order, more precise, or in disagreement.

    Arguments as in `gain`; `tick_s` is the sampling interval, s.
    """
    if shape is not None and not shape.first_order:
        # A T_A of a response that is not first order is less certain than noise alone makes it.
        std = math.hypot(shape.T_A_std * shape.ratio, shape.spread * shape.T_A / math.sqrt(shape.steps))
        return _parameter(
            "T_A",
            shape.T_A,
            std,
            f"best first-order response to {shape.steps} steps, which are not first order (residual {shape.text})",
            "(1)",
        )
    if shape is not None and (
        joint is None or not joint.std <= shape.T_A_std or not _agree(shape.T_A, shape.T_A_std, joint)
    ):
        # Each step has its own levels, so an offset, which (1) does not have, cannot bias T_A.
        return _parameter("T_A", shape.T_A, shape.T_A_std, f"first-order response to {shape.steps} steps", "(1)")
    if joint is None:
        return _absent("T_A", 0.15 * tick_s, warnings)
    parameter = _parameter("T_A", joint.value, joint, "innovations likelihood", "(1), (7)")
    if parameter.verdict != "identified":
        warnings.append(
            f"T_A is {parameter.verdict}: samples every {tick_s * 1e3:g} ms see little of "
            f"{joint.value * 1e3:.3g} ms. To determine it, {_HELP['T_A']}"
        )
    return parameter


def force_constant(
    joint: Interval | None, force: ForceConstant | None, ball: BallStart | None, plant: Plant, warnings: list[str]
) -> Parameter:
    """Return K_c from the joint fit if there are flights, otherwise from lift-off or equilibria (8).

    `force`: K_c by (8).  `ball`: the regression for starting values.  `warnings` receives sentences for the user.
    """
    shift_m = 0.0 if force is None or force.shift_m is None else force.shift_m
    if (
        force is not None
        and abs(shift_m) > settings.AGREEMENT_ERRORS * force.shift_std_m
        and abs(shift_m) > 0.01 * plant.travel_m
    ):
        warnings.append(
            f"the currents that carry the ball point to a coil plane {shift_m * 1e3:+.3g} mm above x_max "
            f"(+- {force.shift_std_m * 1e3:.2g} mm): (3) holds with "
            f"x_max_m = {plant.x_max_m + shift_m:.5g}, or not at all"
        )
    if joint is not None:
        differ = force is not None and not _agree(force.K_c, force.std, joint)
        if force is not None and differ:
            warnings.append(
                f"K_c is {force.K_c:.4g} by (8) and {joint.value:.4g} N m^2/A^2 in flight: no single K_c explains "
                "both. (3) does not hold over the whole travel; board51 diagnose looks for the reason"
            )
        parameter = _parameter("K_c", joint.value, joint, "innovations likelihood over all flights", "(6), (7)")
        if force is None or not differ or abs(force.K_c / joint.value - 1.0) < settings.K_C_DIFFERENT:
            return parameter
        # Two precise but different values: neither interval is that of K_c.
        method = f"{parameter.method}; lift-off (8) says {force.K_c:.4g}"
        verdict: Verdict = "weak" if parameter.verdict == "identified" else parameter.verdict
        return replace(parameter, verdict=verdict, method=method)
    if force is not None:
        kind = "lift-offs" if force.points[0].t_s != 0 and len(force.points) else "equilibria"
        return _parameter("K_c", force.K_c, force.std, f"median of {len(force.points)} {kind}", "(8)")
    if ball is not None and ball.k > 0:
        value = ball.k * plant.mass_kg
        warnings.append("K_c comes from a regression without error: u_c is missing. " + _HELP["K_c"].capitalize())
        return Parameter(
            value=value, unit=PARAMETERS["K_c"][0], verdict="weak", method="modulating functions", equation="(6)"
        )
    return _absent("K_c", 1e-6, warnings)


def drag(
    joint: Interval | None,
    held: float | None,
    ball: BallStart | None,
    plant: Plant,
    warnings: list[str],
    *,
    coloured: bool,
    loop_delay: LoopDelay | None,
) -> Parameter:
    """The drag b; an interval that includes zero is reported, and with coloured residuals b is at most weak.

    Drag is the smallest force, so an effect that the model lacks (a lag, a delay, another force law) biases b first.
    Arguments as in `force_constant`; `held`: the b of the flights, if the best fit has an impossible b; `coloured`:
    whether the residuals are coloured; `loop_delay`: a delay of the current, which biases b.
    """
    if joint is None:
        if held is None or ball is None:
            return _absent("b", 0.0, warnings)
        return _impossible_drag(held, ball.d_std * plant.mass_kg)
    value = joint.value
    # A negative b within its error is chance. Beyond its error it cannot be a drag, so the bound is reported.
    if joint.high <= 0.0:
        warnings.append(
            f"b = {value:.3g} N s/m is negative beyond its error: something that the model lacks feeds energy in "
            "(a delay, a lag). It is set to its bound, 0; board51 diagnose looks for the reason"
        )
        return Parameter(
            value=0.0,
            unit=PARAMETERS["b"][0],
            std=joint.std,
            ci95=(0.0, max(joint.std, 0.0)),
            verdict="not-identifiable",
            method=f"innovations likelihood, at its bound (unbounded {value:.3g}); {joint.method}",
            equation="(5), (7)",
        )
    if loop_delay is not None:
        return _delayed_drag(value, loop_delay, warnings)
    # Left free below 0 in the fit and cut here: a bound in the fit would make the interval wrong.
    parameter = _parameter("b", max(value, 0.0), joint, "innovations likelihood over all flights", "(5), (7)")
    if coloured and parameter.verdict == "identified":
        return replace(
            parameter,
            verdict="weak",
            method=parameter.method + "; the residuals are coloured, and what the model lacks ends up in b first",
        )
    if parameter.verdict != "identified":
        lower = "which includes 0" if joint.low <= 0.0 else "wide"
        warnings.append(
            f"b is {parameter.verdict}: 95 % interval {max(joint.low, 0.0):.3g} to {joint.high:.3g} N s/m, {lower}. "
            f"To know it, {_HELP['b']}"
        )
    return parameter


def _delayed_drag(value: float, loop_delay: LoopDelay, warnings: list[str]) -> Parameter:
    """Return b without an interval, because a delay that the model lacks biases it."""
    delay = f"{loop_delay.delay_s * 1e3:.2g} ms"
    warnings.append(
        f"i_c answers as if u_c acted about {delay} late, which (1) lacks. With that delay b is {loop_delay.b:.3g} "
        f"instead of {value:.3g} N s/m, so it has no interval. board51 diagnose extends the model by the delay"
    )
    return Parameter(
        value=max(value, 0.0),
        unit=PARAMETERS["b"][0],
        verdict="not-identifiable",
        method=f"innovations likelihood; with a delay of {delay} it is {loop_delay.b:.3g}",
        equation="(5), (7)",
    )


def _impossible_drag(b: float, std: float) -> Parameter:
    """Return the drag by regression, or a placeholder, if the best fit has an impossible drag."""
    why = "because the best fit has an impossible drag: the model lacks something that acts faster"
    if b == 0.0:
        return replace(_absent("b", 0.0, []), method=f"placeholder, {why}; board51 diagnose looks for it")
    return Parameter(
        value=b,
        unit=PARAMETERS["b"][0],
        std=std,
        ci95=(max(b - Z_95 * std, 0.0), b + Z_95 * std),
        verdict="not-identifiable",
        method=f"regression over 60 ms windows, {why}; board51 diagnose looks for it",
        equation="(5), (6)",
    )


def _agree(value: float, std: float, joint: Interval) -> bool:
    """Return whether another estimate agrees with that of the joint fit; one with an unknown error (NaN) does."""
    return not abs(joint.value - value) > settings.AGREEMENT_ERRORS * math.hypot(joint.std, std)


def _parameter(name: str, value: float, spread: Interval | float, method: str, equation: str) -> Parameter:
    """Build a parameter from a value with its interval or its standard error."""
    unit, lowest, highest = PARAMETERS[name]
    if isinstance(spread, Interval):
        std, low, high, method = spread.std, spread.low, spread.high, f"{method}; {spread.method}"
    else:
        std, low, high = spread, value - Z_95 * spread, value + Z_95 * spread
    min_std = settings.MIN_RELATIVE_ERROR * abs(value)  # without noise the standard error would be 0
    std, low, high = max(std, min_std), min(low, value - Z_95 * min_std), max(high, value + Z_95 * min_std)
    bounded = min(max(value, lowest), highest)
    low = max(low, 0.0)
    high = high if math.isfinite(high) else highest
    # By the interval, not by the standard error: an estimate at a bound has none, and a profile is asymmetric.
    width = 0.5 * (high - low) / abs(value) if value else _INFINITE
    verdict: Verdict = "identified" if width <= IDENTIFIED else "weak" if width <= WEAK else "not-identifiable"
    if bounded != value:
        verdict = "not-identifiable"
        method += f"; at its bound (unbounded {value:.3g})"
    if verdict != "identified":
        method += f"; to determine it, {_HELP[name]}"
    return Parameter(
        value=bounded,
        unit=unit,
        std=std if math.isfinite(std) else None,
        ci95=(low, high),
        verdict=verdict,
        method=method,
        equation=equation,
    )


def _absent(name: str, value: float, warnings: list[str]) -> Parameter:
    remedy = _HELP[name]
    warnings.append(
        f"{name} is not identifiable from these recordings: {remedy}. The {value:g} in the model is a placeholder"
    )
    return Parameter(
        value=value,
        unit=PARAMETERS[name][0],
        verdict="not-identifiable",
        method=f"placeholder, no recording shows it; {remedy}",
        equation={"K_A": "(1)", "T_A": "(1)", "K_c": "(8)", "b": "(5)"}[name],
    )
