"""Turn the shares of the menu into volts, metres and commands of one rig.  Pure.

Rule 1: all signals are within the limits.  A larger signal is reduced; if too little of it is left, the result is the
        reason, which is reported before the ball moves.
Rule 2: the limits are the board's (`Parameters`), tightened by the options.  The gateway may have tighter limits and
        then refuses commands.
Rule 3: signals on the reference keep the board's limits of step and slew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from gateway.board.reference import reference_range
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Plant
from protocol.errors import UsageError
from protocol.experiments import LIFT_OFF, Burst, CoilOff, Constant, Experiment, Hover, Wave

LEFT_SHARE = 0.4  # of a signal's span that must remain within the limits for the signal to be useful
_JUMPS = ("step", "rectangle", "sawtooth", "prbs")
# Steepest slope over amplitude * 2 pi / period: at most 6.44 for eight harmonics of equal size with Schroeder phases
# and peak 1 (over all 128 signs of the board's multisine).
_MULTISINE_SLOPE = 6.5
CAPTURE_S = 0.04
CAPTURE_PRE_S = 0.004  # whole ticks, so that the step of u_c is at a sample of the stream


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandLimits:
    """Limits of commands."""

    u_min_v: float
    u_max_v: float
    x_min_m: float
    x_max_m: float
    step_m: float
    slew_m_s: float
    u_lsb_v: float = 0.0  # one count of each converter
    x_lsb_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """The units of the menu's shares for one rig."""

    limits: CommandLimits
    travel_m: float
    lift_off_v: float
    seed: int = 1
    u_factor: float = 1.0  # factor on inputs; changed by a repetition
    x_factor: float = 1.0  # factor on amplitudes of the reference; changed by a repetition


@dataclass(frozen=True, slots=True, kw_only=True)
class Send:
    """Send `command`, then wait for `hold_s` of the board's time."""

    command: pb.Command
    hold_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Shoot:
    """A 25 kHz capture: hold u_from for `lead_s`, capture, wait for the samples."""

    u_from_v: float
    u_to_v: float
    lead_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class GoTo:
    """Move the reference to `x_ref_m` as fast as the board allows, then wait for `hold_s`."""

    x_ref_m: float
    hold_s: float


Action = Send | Shoot | GoTo


def limits_of(
    parameters: pb.Parameters, *, u_max_v: float | None, x_min_m: float | None, x_max_m: float | None
) -> CommandLimits:
    """The limits of board and gateway, tightened by the options that are not None: u_c in V, x_ref in m.

    Raises:
        UsageError: an option is outside the board's limits, or leaves no range.
    """
    board = parameters
    low, high = reference_range(board)
    for option, value, bottom, top, unit, whose in (
        ("--u-max", u_max_v, board.u_min_v, board.u_max_v, "V", "the board's"),
        ("--x-min", x_min_m, low, high, "mm", "the board's and the gateway's"),
        ("--x-max", x_max_m, low, high, "mm", "the board's and the gateway's"),
    ):
        scale = 1e3 if unit == "mm" else 1.0
        # Half a count of tolerance, so that values copied from the board's printed limits are accepted.
        slack = 0.5 * abs(board.x_lsb_m if unit == "mm" else board.u_lsb_v) + 1e-9
        if value is not None and not bottom - slack <= value <= top + slack:
            raise UsageError(
                f"{option} {value * scale:g} {unit} is outside {whose} limits,"
                f" {bottom * scale:.4g} .. {top * scale:.4g} {unit}",
                remedy="Give a value inside them; an option only tightens a limit",
            )
    limits = CommandLimits(
        u_min_v=board.u_min_v,
        u_max_v=board.u_max_v if u_max_v is None else u_max_v,
        x_min_m=low if x_min_m is None else x_min_m,
        x_max_m=high if x_max_m is None else x_max_m,
        step_m=board.x_ref_step_max_m,
        slew_m_s=board.x_ref_slew_m_s,
        u_lsb_v=abs(board.u_lsb_v),
        x_lsb_m=abs(board.x_lsb_m),
    )
    if limits.x_min_m >= limits.x_max_m or limits.u_min_v >= limits.u_max_v:
        raise UsageError(
            f"No range is left: x_ref {limits.x_min_m * 1e3:.4g} .. {limits.x_max_m * 1e3:.4g} mm,"
            f" u_c {limits.u_min_v:.4g} .. {limits.u_max_v:.4g} V",
            remedy="Widen --x-min, --x-max or --u-max",
        )
    return limits


def guessed_lift_off_v(parameters: pb.Parameters, plant: Plant, limits: CommandLimits) -> float:
    """Estimate of the lift-off input before it is measured, V.

    By (8) the current that carries the ball is proportional to its distance from x_max.  The operating point (13)
    gives one point of that line.  Without a plausible operating point it is derived from the upper limit.
    """
    u_0, gap = parameters.u_0_v, plant.x_max_m - parameters.x_0_m
    guess = u_0 * plant.x_max_m / gap if u_0 > 0 and gap > 0.05 * plant.x_max_m else math.inf
    # The sawtooth of the menu goes up to 1.1 times this, which must be within the limit.
    return min(guess, limits.u_max_v / 1.1)


def actions_of(experiment: Experiment, scale: Scale) -> tuple[Action, ...] | str:
    """The actions of an experiment in order, or why it is not useful within the limits."""
    actions: list[Action] = []
    for step in experiment.steps:
        match step:
            case CoilOff():
                actions.append(Send(command=pb.Command(set_mode=pb.SetMode(mode=pb.MODE_IDLE)), hold_s=step.duration_s))
            case Constant():
                constant = pb.Excite(shape=pb.SHAPE_NONE, offset=_volts(step.value, scale))
                actions.append(Send(command=pb.Command(excite=constant), hold_s=step.duration_s))
            case Burst():
                u_from, u_to = _volts(step.u_from, scale), _volts(step.u_to, scale)
                actions.append(Shoot(u_from_v=u_from, u_to_v=u_to, lead_s=step.lead_s))
            case Hover():
                actions.append(GoTo(x_ref_m=_metres(step.value, scale), hold_s=step.duration_s))
            case Wave():
                played = _on_reference(step, scale) if step.on_reference else _on_input(step, scale)
                if isinstance(played, str):
                    return f"{experiment.name}: {played}"
                actions.append(played)
    if experiment.name == "holds" and (distinct := len({a.x_ref_m for a in actions if isinstance(a, GoTo)})) < 5:
        return f"{experiment.name}: the limits of x_ref leave {distinct} different positions"
    return tuple(actions)


def raised(scale: Scale, *, attempt: int) -> Scale:
    """The scale of the next attempt if the ball was not lifted: a quarter more, finally up to the limit."""
    return replace(scale, u_factor=scale.u_factor * 1.25 if attempt < 2 else math.inf)


def _volts(share: float, scale: Scale) -> float:
    limits = scale.limits
    if share == 0.0:
        return limits.u_min_v
    return min(max(share * scale.u_factor * scale.lift_off_v, limits.u_min_v), limits.u_max_v)


def _metres(share: float, scale: Scale) -> float:
    return min(max(share * scale.travel_m, scale.limits.x_min_m), scale.limits.x_max_m)


def _on_input(wave: Wave, scale: Scale) -> Send | str:
    low, high = _volts(wave.low, scale), _volts(wave.high, scale)
    span = (wave.high - wave.low) * scale.lift_off_v
    if high - low < LEFT_SHARE * span:
        return f"u_c up to {scale.limits.u_max_v:.4g} V leaves too little of the {wave.shape}"
    return _send(wave, scale, low, high)


def _on_reference(wave: Wave, scale: Scale) -> Send | str:
    limits = scale.limits
    low, high = _metres(wave.low, scale), _metres(wave.high, scale)
    if low >= high:  # the whole signal is outside the limits: use the full range
        low, high = limits.x_min_m, limits.x_max_m
    middle, span = (low + high) / 2, (wave.high - wave.low) * scale.travel_m
    half = min((high - low) / 2, span / 2) * scale.x_factor
    # A jump is bounded by the board's step, a smooth signal by its slew: a sine's steepest slope is A 2 pi / T.
    if wave.shape in _JUMPS:
        half = min(half, limits.step_m / 2)
    else:
        fastest = min(wave.period_s, wave.period_end_s or wave.period_s)
        slope = 2 * math.pi / fastest * (_MULTISINE_SLOPE if wave.shape == "multisine" else 1.0)
        half = min(half, limits.slew_m_s / slope)
    if 2 * half < LEFT_SHARE * span * min(scale.x_factor, 1.0):
        return (
            f"x_ref {limits.x_min_m * 1e3:.3g} .. {limits.x_max_m * 1e3:.3g} mm, {limits.step_m * 1e3:.3g} mm at"
            f" once and {limits.slew_m_s * 1e3:.3g} mm/s leave too little of the {wave.shape}"
        )
    return _send(wave, scale, middle - half, middle + half)


def _send(wave: Wave, scale: Scale, low: float, high: float) -> Send:
    # Offset and amplitude are each rounded to counts, so their sum may exceed the limit by one count.
    count = scale.limits.x_lsb_m if wave.on_reference else scale.limits.u_lsb_v
    excite = pb.Excite(
        shape=f"SHAPE_{wave.shape.upper()}",
        on_reference=wave.on_reference,
        amplitude=max((high - low) / 2 - count, 0.0),
        offset=(high + low) / 2,
        period_s=wave.period_s,
        period_end_s=wave.period_end_s,
        seed=(scale.seed * 101 + wave.salt) % 0xFFFF + 1,
        duration_s=wave.duration_s,
    )
    return Send(command=pb.Command(excite=excite), hold_s=wave.duration_s)


def needs_lift_off(experiment: Experiment) -> bool:
    """Return whether the experiment needs a measured lift-off input."""
    return experiment.name != LIFT_OFF and any(
        isinstance(step, Burst | Constant) or (isinstance(step, Wave) and not step.on_reference)
        for step in experiment.steps
    )
