"""Checks whether a recording is usable: from samples to problems.  Pure.

Rule 1: a check finds faults of the recording.  Effects for the diagnosis (another force law, coloured noise, single
        lost samples) pass.
Rule 2: positions are relative to the reading at rest and to the travel, because the sensor may have an offset.
Rule 3: each problem says what was observed, and whether and how a repetition may help (`Cure`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gateway.campaign.plan import CommandLimits
from gateway.client.commands import Mode
from gateway.client.values import Samples
from protocol.bus import board51_pb2 as pb
from protocol.experiments import Experiment, Wave
from protocol.wire.messages import Flag

FloatArray = NDArray[np.float64]
Cure = Literal["again", "raise", "lower", "none"]

MAX_LOST_SHARE = 0.15  # of the samples; with fewer single losses a rig can be identified
LONGEST_GAP_S = 0.05  # four time constants of the unstable pole
CLIPPED_SHARE = 0.01  # of the samples at a converter's end
SATURATED_SHARE = 0.25  # of the samples with u_c at a limit: the law no longer controls
LIFTED_SHARE = 0.1  # of the travel: a ball farther from its rest has left it
STOP_SHARE = 0.03  # of the travel: a ball nearer to a stop is at it
AT_STOP_S = 0.1  # longest time at a stop in closed loop; an overshoot touches it for some 10 ms
OFF_SHARE = 0.06  # of the travel: largest median distance of x from x_ref
FOLLOWED_SHARE = 0.2  # of the reference's range: a ball that moves less does not follow it
MAX_CLAMPED_SHARE = 0.02  # of the travel: largest motion of a clamped ball
AT_LIMIT_SHARE = 0.98
FEWEST_CROSSINGS_PER_S = 1.0  # of the middle of the travel, in open-loop flight


@dataclass(frozen=True, slots=True)
class Problem:
    """A reason why a recording is not usable."""

    code: str  # stable name in kebab-case
    text: str
    cure: Cure = "again"


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedRig:
    """Data of the rig for the checks."""

    limits: CommandLimits
    travel_m: float
    rest_m: float  # reading of x with the ball at rest
    sample_time_s: float


def check(
    experiment: Experiment,
    samples: Samples,
    captures: Sequence[pb.CaptureRecord],
    events: Iterable[pb.Event],
    rig: CheckedRig,
) -> tuple[Problem, ...]:
    """The problems of a recording; empty if it is usable."""
    problems = [_continuity(samples, events, rig)]
    # In this order: a gap or a fault would fail the later checks for a reason that is not theirs.
    if not any(problems):
        problems = [*_converters(experiment, samples), _captures(experiment, captures)]
    if not any(problems):
        match experiment.expects:
            case "rests" | "is-clamped":
                problems = [_at_rest(experiment, samples, rig)]
            case "lifts-off":
                problems = [_lifts(experiment, samples, rig)]
            case "bounces":
                problems = [_bounces(samples, rig)]
            case "flies":
                problems = [_flies(experiment, samples, rig)]
    return tuple(problem for problem in problems if problem is not None)


def rest_level_m(x_m: Sequence[float]) -> float:
    """Reading of x at rest, m: the median of samples taken there; NaN without samples."""
    return float(np.median(x_m)) if len(x_m) else float("nan")


def departures_v(samples: Samples, rig: CheckedRig) -> list[float]:
    """The inputs at which the ball left its rest, V, one for each lift-off.

    They are read when x has visibly moved, some 10 ms after the lift-off.  On a ramp of 1 V/s this is 0.01 V too much,
    which is accurate enough to choose amplitudes; identification finds the instant itself.
    """
    away = samples.x_m - rig.rest_m > STOP_SHARE * rig.travel_m
    rest_samples = round(0.1 / rig.sample_time_s)
    leaves = np.flatnonzero(away[1:] & ~away[:-1]) + 1
    return [float(samples.u_c_v[k]) for k in leaves if k >= rest_samples and not away[k - rest_samples : k].any()]


def lift_off_v(samples: Samples, rig: CheckedRig) -> float | None:
    """The lift-off input, V: the median over all lift-offs; None without any."""
    departures = departures_v(samples, rig)
    return float(np.median(departures)) if departures else None


def _continuity(s: Samples, events: Iterable[pb.Event], rig: CheckedRig) -> Problem | None:
    if len(s) < 2:
        return Problem("no-samples", f"{len(s)} samples arrived")
    if len(np.unique(s.session)) > 1:
        why = next((e.text for e in events if e.source == "board" and e.name.startswith("reset")), "")
        return Problem("board-reset", f"the board began a new session in between. {why}".rstrip(" ."))
    faults = [event for event in events if event.severity == "fault"]
    if (s.flags & Flag.FAULT).any() or faults:
        named = "; ".join(f"{event.name}: {event.text}".rstrip(".") for event in faults) or "the board reports a fault"
        return Problem("fault", named)
    steps = np.diff(s.tick)
    lost = int(np.sum(steps - 1))
    gap_s = float(np.max(steps) - 1) * rig.sample_time_s
    share = lost / (len(s) + lost)
    # The share alone would let one long gap pass, in which the ball may have been anywhere.
    if share > MAX_LOST_SHARE or gap_s > LONGEST_GAP_S:
        return Problem(
            "samples-lost",
            f"{lost} samples are missing ({100 * share:.2g} %), {gap_s * 1e3:.3g} ms in one place"
            f" (allowed: {100 * MAX_LOST_SHARE:g} %, {LONGEST_GAP_S * 1e3:g} ms)",
        )
    return None


def _converters(experiment: Experiment, s: Samples) -> list[Problem]:
    problems = []
    current = float(np.mean((s.flags & Flag.CURRENT_RANGE) != 0))
    if current > CLIPPED_SHARE:
        text = f"i_c is at an end of its converter in {100 * current:.0f} % of it"
        problems.append(Problem("clipped-i_c", text, "lower"))
    position = float(np.mean((s.flags & Flag.POSITION_RANGE) != 0))
    if position > CLIPPED_SHARE and experiment.expects == "flies":  # at a stop, a sensor with an offset may be clipped
        text = f"x is at an end of its converter in {100 * position:.0f} % of it"
        problems.append(Problem("clipped-x", text, "none"))
    for name, values in (("u_c", s.u_c_v), ("i_c", s.i_c_a), ("x", s.x_m)):
        known = values[np.isfinite(values)]
        if not len(known):
            problems.append(Problem(f"no-{name}", f"{name} was not measured", "none"))
        elif np.ptp(known) == 0.0 and not (name == "x" and experiment.expects in ("rests", "is-clamped")):
            text = f"{name} reads {known[0]:.6g} throughout: not connected?"
            problems.append(Problem("nothing-moves", text, "none"))
    if not problems and experiment.expects != "flies" and _correlation(s.u_c_v, s.i_c_a) < 0.1:
        text = "i_c does not follow u_c: amplifier off, or not connected"
        problems.append(Problem("no-response", text, "none"))
    return problems


def _correlation(a: FloatArray, b: FloatArray) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    return float(np.corrcoef(a[both], b[both])[0, 1])


def _captures(experiment: Experiment, captures: Sequence[pb.CaptureRecord]) -> Problem | None:
    expected = len(experiment.captures)
    if len(captures) < expected:
        return Problem("captures-missing", f"{len(captures)} of {expected} captures arrived")
    clear = 0
    for capture in captures:
        i = np.array(capture.i_c_a)
        if not 0 < capture.step_index < len(i) - 20:
            return Problem("capture-short", f"a capture has {len(i)} samples")
        # The last quarter: T_A is not known yet, and before it the current may still settle.
        before, after = i[: capture.step_index], i[-len(i) // 4 :]
        noise = max(float(np.std(before)), float(np.std(after)), 1e-9)
        clear += abs(float(np.mean(after) - np.mean(before))) > 3.0 * noise
    if 2 * clear < expected:  # small steps may lie within a dead zone of the rig
        return Problem("no-response", f"i_c answers {clear} of {expected} captured steps of u_c", "none")
    return None


def _at_rest(experiment: Experiment, s: Samples, rig: CheckedRig) -> Problem | None:
    far = float(np.max(np.abs(s.x_m - rig.rest_m))) / rig.travel_m
    if experiment.expects == "is-clamped":
        far = float(np.ptp(s.x_m)) / rig.travel_m
        if far > MAX_CLAMPED_SHARE:
            return Problem("ball-moves", f"the ball moves by {100 * far:.0f} % of its travel", "none")
    elif far > LIFTED_SHARE:
        return Problem("ball-moves", "the ball left its rest, but it should lie still", "lower")
    return None


def _lifts(experiment: Experiment, s: Samples, rig: CheckedRig) -> Problem | None:
    ramps = sum(int(step.duration_s / step.period_s + 1e-6) for step in experiment.steps if isinstance(step, Wave))
    departures = departures_v(s, rig)
    highest = float(np.max(s.x_m)) - rig.rest_m
    if highest < LIFTED_SHARE * rig.travel_m:
        top = float(np.max(s.u_c_v))
        at_limit = top > AT_LIMIT_SHARE * rig.limits.u_max_v  # a ramp ends one step short of its top
        hint = "; that is the limit: raise --u-max, or look whether the ball is stuck" if at_limit else ""
        text = f"the ball never left its rest (u_c went up to {top:.3g} V{hint})"
        return Problem("never-lifted", text, "none" if at_limit else "raise")
    if len(departures) < max(ramps - 1, 1):
        return Problem("few-lift-offs", f"the ball left a steady rest {len(departures)} times in {ramps} ramps")
    spread = float(np.ptp(departures)) / float(np.median(departures))
    if spread > 0.1:
        low_v, high_v = min(departures), max(departures)
        text = f"it leaves its rest between {low_v:.3g} and {high_v:.3g} V: it sticks or is pushed"
        return Problem("unsteady-lift-off", text)
    return None


def _bounces(s: Samples, rig: CheckedRig) -> Problem | None:
    x = s.x_m - rig.rest_m
    if float(np.max(x)) < LIFTED_SHARE * rig.travel_m:
        return Problem("never-lifted", "the ball never left its rest", "raise")
    above = x > 0.5 * rig.travel_m
    # Crossings, not the range of x: one jump to the top would pass, and shows too little of flight.
    crossings = int(np.count_nonzero(above[1:] != above[:-1]))
    seconds = float(s.tick[-1] - s.tick[0]) * rig.sample_time_s
    if crossings < FEWEST_CROSSINGS_PER_S * seconds:
        high = above.mean() > 0.5
        stays = "on top" if high else "below"
        text = f"the ball crosses the middle {crossings} times in {seconds:.1f} s and mostly stays {stays}"
        return Problem("hardly-flies", text, "again" if high else "raise")
    return None


def _flies(experiment: Experiment, s: Samples, rig: CheckedRig) -> Problem | None:
    if (s.mode != Mode.CLOSED_LOOP).any():
        return Problem("mode-changed", "the board left closed loop in between")
    x = s.x_m - rig.rest_m
    if float(np.ptp(x)) < FOLLOWED_SHARE * float(np.ptp(s.x_ref_m)):
        return Problem("nothing-moves", "x_ref moves, the ball does not")
    at_stop = (x < STOP_SHARE * rig.travel_m) | (x > (1 - STOP_SHARE) * rig.travel_m)
    longest_s = _longest(at_stop) * rig.sample_time_s
    if longest_s > AT_STOP_S:
        return Problem("ball-fell", f"the ball lay at a stop for {longest_s:.2g} s", "lower")
    # Within a count: the converter rounds u_c at its limit.
    ends = (s.u_c_v >= rig.limits.u_max_v - rig.limits.u_lsb_v) | (s.u_c_v <= rig.limits.u_min_v + rig.limits.u_lsb_v)
    share = float(np.mean(ends | ((s.flags & Flag.INPUT_SATURATED) != 0)))
    if share > SATURATED_SHARE:
        return Problem("clipped-u_c", f"u_c is at a limit in {100 * share:.0f} % of the samples", "lower")
    # The loop cannot follow a fast reference point by point, so only the mean is compared.
    fast = any(isinstance(step, Wave) and step.shape in ("prbs", "multisine", "chirp") for step in experiment.steps)
    error = s.x_m - s.x_ref_m
    off = abs(float(np.nanmean(error) if fast else np.nanmedian(np.abs(error)))) / rig.travel_m
    if off > OFF_SHARE:
        return Problem("reference-not-reached", f"x is {100 * off:.0f} % of the travel off its reference", "lower")
    return None


def _longest(mask: NDArray[np.bool_]) -> int:
    """Length of the longest stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
