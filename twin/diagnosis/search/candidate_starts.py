"""The starting values of the fit of a candidate.

A wrong model bends its own parameters: under a current limit K_A comes out low and T_A long, and from there the limit
explains nothing.  So a candidate of the amplifier has further starts besides the linear step of the score test.  Their
K_A and T_A hardly depend on single samples: the median of i_c / u_c, and the fastest response of any recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from protocol.campaign import Plant
from twin.diagnosis.search.probes import probes_of
from twin.diagnosis.search.score_test import Score, probed, two_sided
from twin.estimation.record import Record
from twin.evidence.starting.regression import amplifier_start
from twin.inference.likelihood import Criterion
from twin.inference.theta import (
    COLOURS,
    NOISES,
    PARAMETERS,
    STOPS,
    Theta,
    max_step,
    moved,
    parameter_of,
    with_equal_rests,
)
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings


def start_of(criterion: Criterion, theta: Theta, score: Score) -> Theta:
    """The best of the starts by the likelihood itself."""
    cause, theta = BY_NAME[score.cause], replace(theta, phases_s=score.phases_s or theta.phases_s)
    # Many starts, each judged by one run of the filter: a pass of a fit costs a run for each free number.
    starts = [
        start
        for names in _coordinate_sets(score)
        for part in settings.START_PARTS
        for start in _linear(criterion, theta, score, part, names)
    ]
    if cause.family == "amplifier":
        gains, times = {theta.K_A}, {theta.T_A}
        robust = robust_gain(criterion.evidence.records)
        if robust is not None:
            gains.add(robust)
        quick = shortest_time_constant(criterion.evidence.records)
        if quick is not None:
            # Only a shorter T_A is another start: what a model lacks mostly makes its T_A longer.
            times.add(min(quick, theta.T_A))
        values = [(name, value) for name, value in score.other_values if name.startswith(f"{cause.name}.")]
        for K_A in sorted(gains):
            for T_A in sorted(times):
                for probe in probes_of(cause, criterion.evidence.series):
                    starts.append(probed(replace(theta, K_A=K_A, T_A=T_A), cause, probe, values))
    starts = _with_stops(criterion.plant, theta, starts, cause)
    return starts[int(np.argmax(criterion.values(starts)))]


def _with_stops(plant: Plant, theta: Theta, starts: list[Theta], cause: Cause) -> list[Theta]:
    """Add starts with other stops to those of a sensor's cause: at their nominal positions, and with equal readings.

    A model without the cause shifts the stops to where the sensor shows them.  With the cause and these stops the
    offset would count twice.  With nominal stops, part of an offset is wrong by hundreds of standard errors at rest,
    which outweighs all else.
    """
    if cause.family != "sensing":
        return starts
    at_home = [replace(start, stop_low_m=0.0, stop_high_m=0.0) for start in starts]
    return [*at_home, *(with_equal_rests(start, theta, cause.name, plant) for start in starts)]


def substitute_start(criterion: Criterion, theta: Theta, cause: Cause, confounder: Cause) -> Theta:
    """The best strength of `confounder` with the numbers of `theta`, in which it replaces `cause`.

    The parameters of a model without both causes are bent.  From there a cause with the same effect may never reach its
    maximum.  Two causes in the same unit, or in V and A, may be of equal size, so that size is tried, too.
    """
    strength = confounder.strength
    at = [strength.coordinate(probe) * factor for probe in strength.probes for factor in settings.START_SIZES]
    if two_sided(confounder):
        at += [-coordinate for coordinate in at]
    sizes = [strength.value(coordinate) for coordinate in at]
    same = {(strength.unit, strength.unit): 1.0, ("V", "A"): theta.K_A, ("A", "V"): 1.0 / theta.K_A}
    if (cause.strength.unit, strength.unit) in same:
        size = theta.value(f"{cause.name}.{cause.strength.name}") * same[cause.strength.unit, strength.unit]
        sizes += [signed for signed in (size, -size) if strength.low <= signed <= strength.high]
    bare = theta.without(cause.name, criterion.plant)
    starts = _with_stops(criterion.plant, theta, [probed(bare, confounder, size) for size in sizes], confounder)
    return starts[int(np.argmax(criterion.values(starts)))]


def robust_gain(records: Sequence[Record]) -> float | None:
    """Return K_A as the median of i_c / u_c where u_c has stood still, A/V."""
    ratios = []
    for record in records:
        if record.kind == "equilibria" or not record.has("u_c", "i_c") or len(record.t) < 2 * settings.STEADY_SAMPLES:
            continue
        u, i = record.u_c, record.i_c
        # Where u_c stands still no lag counts.  The median, not a regression: readings under a limit are all off to one
        # side.
        steady = np.ones(len(u), np.bool_)
        for lag in range(1, settings.STEADY_SAMPLES):
            steady[lag:] &= np.abs(u[lag:] - u[:-lag]) <= settings.STEADY_CHANGE * np.abs(u[lag:])
        steady[: settings.STEADY_SAMPLES] = False
        good = steady & (u > settings.STEADY_INPUT * np.nanmax(u)) & np.isfinite(i)
        if good.sum() >= settings.STEADY_READINGS:
            ratios.append(i[good] / u[good])
    if not ratios:
        return None
    gain = float(np.median(np.concatenate(ratios)))
    return gain if gain > 0.0 else None


def shortest_time_constant(records: Sequence[Record]) -> float | None:
    """The shortest T_A that any single recording or capture of steps asks for, s."""
    time_constants = []
    for record in records:
        # Each response alone: in a joint fit those that a limit slows down would lengthen the T_A of the others.
        singles = [replace(record.part(slice(0, 0)), captures=(capture,)) for capture in record.captures]
        if record.kind == "amplifier-step" and len(record.t):
            singles.append(replace(record, captures=()))
        for single in singles:
            start = amplifier_start([single])
            if start is not None and start.K_A > 0.0 and start.share > settings.STEP_EXPLAINED:
                time_constants.append(start.T_A)
    return min(time_constants) if time_constants else None


def _coordinate_sets(score: Score) -> list[list[str]]:
    """Return the sets of coordinates that move with a candidate: the paper's parameters, or all but the noise levels.

    The positions of coil, stop and sensor differ in their effect by bends alone, so they move together.  So does a
    cause in the model that has taken up the candidate's effect: otherwise the start is 10 000 of log-likelihood lower.
    """
    # With a sensor's cause the stops follow by themselves, and a limit of their steps would shorten all.
    absent = NOISES + COLOURS + (STOPS if BY_NAME[score.cause].family == "sensing" else ())
    names = [name for name, _ in score.moves if name not in absent]
    paper = [name for name in names if name in PARAMETERS]
    together = "displaces" in BY_NAME[score.cause].traits or any("." in name for name in names)
    return [paper, names] if together else [paper]


def _linear(criterion: Criterion, theta: Theta, score: Score, part: float, names: Sequence[str]) -> list[Theta]:
    strength = BY_NAME[score.cause].strength
    # In units of the usual probe: the same distance is more steps of a finer probe.
    max_reach = settings.START_MAX_REACH / min(score.fineness, 1.0)
    reach = min(max(score.step, -max_reach), max_reach)
    # A step near 0 only says that the slope vanishes there, as that of a delay does.  So a usual size is tried.
    reach = reach if abs(reach) > settings.START_MIN_REACH else settings.START_USUAL_REACH
    # All moves are shortened by one factor: they compensate each other only in proportion.
    shorter = min(
        [1.0, *(max_step(name) / max(abs(move * reach), 1e-300) for name, move in score.moves if name in names)]
    )
    reach *= max(shorter, settings.START_MIN_REACH / abs(reach)) * part
    for name, move in score.moves:
        if name in names:
            max_move = max_step(name)  # a coordinate that the data do not determine would run away
            theta = moved(theta, name, min(max(move * reach, -max_move), max_move), criterion.plant)
    value = strength.value(strength.coordinate(score.probe) * reach)
    # A shape that acts beside a strength of its own grows with the step, and may change its sign; another one does not.
    grown = tuple((name, _grown(name, known, reach)) for name, known in score.other_values)
    return [probed(theta, BY_NAME[score.cause], value, shapes) for shapes in dict.fromkeys((score.other_values, grown))]


def _grown(name: str, value: float, reach: float) -> float:
    """Return a value of a probe at that many times its size, if it is a shape of either sign; else the value."""
    if "." not in name:
        return value
    shape = parameter_of(name)
    return shape.value(shape.coordinate(value) * reach) if shape.low < shape.neutral < shape.high else value
