"""An outlying recording: one of another rig, or of another day, among recordings that agree.

The search runs if neither a cause nor a change between recordings leaves just noise.  It also runs if an offset
wanders, because that may be another offset in one recording.

Rule 1: a recording is an outlier if the paper's model with other parameters, x_max included, explains it down to its
        noise.  The parameters must differ by more than a drift.  A recording with an unknown effect is not an outlier:
        no parameters explain it.
Rule 2: the other recordings must be explained without it; the caller checks that with a diagnosis of them alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from protocol.errors import DataError
from twin.estimation.innovations import FLIES, information
from twin.estimation.record import runs
from twin.evidence.gather import gather
from twin.evidence.instruments import with_noise
from twin.evidence.outliers import without_outliers
from twin.inference.adequacy import adequate
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.initial_guess import start_theta, with_noise_bounds
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor, expected
from twin.inference.optimiser import inverse
from twin.inference.theta import BASE, FLOORS, coordinates_of, reinitialised
from twin.model.causes.catalogue import CATALOGUE
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlier:
    """The outlying recording and its parameters."""

    recording: int
    name: str
    moves: tuple[tuple[str, float], ...]  # (parameter, relative change from that of the other recordings)


def find_outlier(criterion: Criterion, base: Fit, floor: Floor) -> Outlier | None:
    """Find the recording that contradicts all others; None if none does.

    Args:
        criterion: of the recordings for fitting.
        base: the paper's model, fitted to all of them.
        floor: what sensor noise alone leaves.
    """
    number, evidence = _most_different(criterion, base), criterion.evidence
    if number is None:
        return None
    record = evidence.records[number]
    rest = [other for index, other in enumerate(evidence.records) if index != number]
    plant, stops = criterion.plant, (evidence.low_m, evidence.high_m)
    try:
        # The recording alone must be explained by another rig, not only disagree: a recording with an unknown effect
        # disagrees, too, and is evidence that must not be thrown away.
        start = with_noise_bounds(start_theta([record], plant), evidence)
    except DataError:
        return None  # one recording does not suffice for a start
    budget = criterion.budget
    parts = [gather([record], plant, stops), gather(rest, plant, stops)]
    parts = [with_noise(without_outliers(part), evidence.noise) for part in parts]
    single = Criterion(parts[0], plant, criterion.tick_s, budget=budget)
    agreeing = Criterion(parts[1], plant, criterion.tick_s, budget=budget)
    try:
        # Another rig has its coil at another height, too.
        (cause,) = (cause for cause in CATALOGUE if cause.family == "force" and "displaces" in cause.traits)
        (coil,) = coordinates_of(cause.name)
        fit = climb(single, start.having(coil, 0.0), (*BASE, *start.colours, coil), passes=2 * settings.PASSES)
        agreed = climb(agreeing, reinitialised(base.theta), base.free)
        # The noise of its own sensors counts, as another rig has other sensors.
        quiet = replace(fit.theta, process_i_c_a=FLOORS["process_i_c_a"], process_a_m_s2=FLOORS["process_a_m_s2"])
        logliks, counts = expected(single.outputs(quiet))
        # Other parameters have to explain it down to its noise.  To ask only for a better fit would discard every
        # recording with an effect of its own.
        if not adequate(single, fit, replace(floor, logliks=logliks, counts=counts))[0]:
            return None
        moves = {name: math.log(fit.theta.value(name) / agreed.theta.value(name)) for name in settings.DRIFT}
    finally:
        single.close()
        agreeing.close()
    large = tuple(
        (name, math.expm1(logarithm)) for name, logarithm in moves.items() if abs(logarithm) > settings.DRIFT[name]
    )
    return Outlier(recording=number, name=record.name, moves=large) if large else None


def _most_different(criterion: Criterion, base: Fit) -> int | None:
    """Return the recording that would gain most by parameters of its own; None if none would gain much."""
    series, names = criterion.evidence.series, BASE[:4]
    # With few recordings nobody knows which of them is the odd one.
    if len(np.unique(series.recording[series.flags & FLIES != 0])) < settings.OUTLIER_RECORDINGS:
        return None
    out, change = criterion.derivatives(base.theta, names)
    best: tuple[float, int] = (settings.OUTLIER_GAIN, -1)
    for number in range(len(criterion.evidence.records)):
        in_recording = np.asarray(series.recording == number)
        if np.count_nonzero(series.flags[in_recording] & FLIES) < settings.OUTLIER_SAMPLES:
            continue
        (piece,) = runs(in_recording)
        each, fisher = np.empty((piece.stop - piece.start, len(names))), np.zeros((len(names), len(names)))
        information(out[piece], np.ascontiguousarray(change[:, piece]), each, fisher)
        score = each.sum(axis=0)
        # The score of one recording at the common fit, in place of a fit without each: one set of derivatives serves
        # all.
        gain = 0.5 * float(score @ inverse(fisher) @ score)
        best = max(best, (gain, number))
    return best[1] if best[1] >= 0 else None
