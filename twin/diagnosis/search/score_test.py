"""The score test: how much would each cause of the catalogue gain, and can these data show it?

Each candidate is tested on the innovations of all recordings together.  Effects that the parameters of the model can
take up are projected out: (S 8), (S 9) of docs/theory/statistics.md (C. R. Rao, 1948).  A probe or two of each
candidate replace a fit, with the slopes of the model as it is.  That is exact enough to choose the candidates for a
fit (tests/twin/inference/test_derivatives.py).

Rule 1: the signature of a candidate is a secant to a small value, because a limit that is not reached has no
        derivative.
Rule 2: a candidate is not testable, and reported as such, if less than VISIBLE of its signature remains after the
        projection.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnosis.search.probes import probes_of
from twin.estimation.innovations import information
from twin.estimation.pace import Reuse
from twin.estimation.record import FloatArray
from twin.inference.likelihood import Criterion, nearby_reuse
from twin.inference.optimiser import inverse
from twin.inference.theta import Theta, coordinates_of, derivative_step, moved
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings

Probe = tuple[Cause, float, tuple[tuple[str, float], ...]]  # a cause, its strength, values of its other parameters


@dataclass(frozen=True, slots=True, kw_only=True)
class Projection:
    """The signature of a probe without what the free parameters of the model take up, (S 8)."""

    slope: float  # of the log-likelihood, by the size in units of the probe
    information: float  # on that size
    visible: float  # share of the information that is left
    moves: tuple[tuple[str, float], ...]  # moves of the free coordinates that go with a whole probe


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """The score of a candidate."""

    cause: str
    probe: float  # value of the strength at which the signature was computed
    gain: float  # estimated increase of the log-likelihood
    step: float  # of the coordinate towards the maximum, in units of the probe
    z: float  # how far from absent, in standard errors, signed
    detectable: float  # standard errors by which the probe itself would show
    visible: float  # share of the signature that nothing in the model takes up
    moves: tuple[tuple[str, float], ...]  # moves of the other coordinates that go with a whole step
    chance: float = 0.0  # gain that the search for the cause's other parameters makes out of noise
    phases_s: tuple[float, ...] = ()  # of a periodic force, as `Theta` has them
    other_values: tuple[tuple[str, float], ...] = ()  # values of other parameters that are not usual

    @property
    def testable(self) -> bool:
        """Tell whether these data can show it."""
        return self.visible >= settings.VISIBLE and self.detectable >= settings.MIN_INFORMATION * min(
            self.fineness, 1.0
        )

    @property
    def fineness(self) -> float:
        """The probe in units of the cause's usual one."""
        strength = BY_NAME[self.cause].strength
        return abs(strength.coordinate(self.probe) / strength.coordinate(strength.probes[0]))


def screen(
    criterion: Criterion, theta: Theta, free: Sequence[str], candidates: Sequence[Cause] = CATALOGUE
) -> list[Score]:
    """The candidates' scores at a maximum, best first; those already in the model are left out.

    For a part of the samples (`Criterion.thinner`) they are scaled to all samples.
    """
    present = {name.partition(".")[0] for name, _ in theta.causes}
    trials = [
        (cause, probe, shape)
        for cause in candidates
        if cause.name not in present and not cause.not_testable and cause.detector == "score-test"
        for probe in probes_of(cause, criterion.evidence.series)
        for shape in shapes_of(cause)
    ]
    best: dict[str, Score] = {}
    for (cause, probe, shape), projection in zip(trials, projections(criterion, theta, free, trials), strict=True):
        if projection is None:
            continue
        slope, left = projection.slope, projection.information
        step = slope / left
        # A one-sided cause that the data want negative is absent.  It stays in the list, for its largest possible size.
        if step < 0.0 and not two_sided(cause):
            gain, step = 0.0, 0.0
        else:
            gain = 0.5 * slope * slope / left
        entry = Score(
            cause=cause.name,
            probe=probe,
            gain=gain / criterion.share,
            step=step,
            z=slope / math.sqrt(left * criterion.share),
            detectable=math.sqrt(left / criterion.share),
            visible=projection.visible,
            moves=projection.moves,
            other_values=shape,
        )
        # The probe that gains most stands for the cause: at another size a limit may have no signature at all, or one
        # of rounding errors, whose gain means nothing.
        if cause.name not in best or _rank(entry) > _rank(best[cause.name]):
            best[cause.name] = entry
    return sorted(best.values(), key=lambda entry: -entry.gain)


def _rank(entry: Score) -> tuple[bool, float]:
    return entry.testable, entry.gain


def projections(
    criterion: Criterion, theta: Theta, free: Sequence[str], trials: Sequence[Probe]
) -> list[Projection | None]:
    """Return the projection of each probe at a maximum; None without a signature."""
    score, fisher = _sums(criterion, theta, free, trials)
    k = len(free)
    # Schur complement: the information on a candidate that the free parameters of the model cannot take up.
    inner = inverse(fisher[:k, :k])
    result: list[Projection | None] = []
    for index in range(k, k + len(trials)):
        # (S 8), (S 9).  One candidate at a time beside the free numbers: all candidates together would share what each
        # explains alone.
        cross, total = fisher[:k, index], float(fisher[index, index])
        if not (total > 0.0 and math.isfinite(total)):
            result.append(None)
            continue
        # Rounding may leave less than nothing.  The floor is below VISIBLE, so such a candidate is refused and not
        # divided by.
        left = max(total - float(cross @ inner @ cross), 1e-12 * total)
        moves = tuple(zip(free, (-(inner @ cross)).tolist(), strict=True))
        slope = float(score[index] - cross @ inner @ score[:k])
        result.append(Projection(slope=slope, information=left, visible=left / total, moves=moves))
    return result


def _sums(
    criterion: Criterion, theta: Theta, free: Sequence[str], trials: Sequence[Probe]
) -> tuple[FloatArray, FloatArray]:
    """The score, shape (k,), and the Fisher information, shape (k, k), of the free parameters and the probes."""
    run = criterion.run(theta)
    base, free_change = criterion.derivatives(theta, free, run, rough=True)
    models = [probed(theta, cause, probe, shape) for cause, probe, shape in trials]
    # The slopes of a ball that may stick are not those of one that cannot.
    # Gains or slopes of the model without a cause serve for its probe: it is small, and such a run is cheap.
    strengths = [(cause, coordinates_of(cause.name)[0]) for cause, *_ in trials]
    reuse = [Reuse.NONE if "sticks" in cause.traits else nearby_reuse(name) for cause, name in strengths]
    change = np.concatenate((free_change, criterion.changes(models, [1.0] * len(models), run, reuse)))
    count = len(change)
    fisher, each = np.zeros((count, count)), np.empty((len(base), count))
    information(base, change, each, fisher)
    steps = [derivative_step(theta, name, criterion.plant) for name in free]
    free_models = [moved(theta, name, step, criterion.plant) for name, step in zip(free, steps, strict=True)]
    score, curvature = criterion.outside.slopes(theta, [*free_models, *models], [*steps, *(1.0 for _ in trials)])
    return each.sum(axis=0) + score, fisher + curvature


def shapes_of(cause: Cause) -> list[tuple[tuple[str, float], ...]]:
    """The coordinates of the forms that are looked at; () for the usual one."""
    forms = [form.values.items() for form in cause.forms if form.probed]
    return [
        (),
        *(tuple((f"{cause.name}.{k}", value) for k, value in form if not isinstance(value, str)) for form in forms),
    ]


def probed(theta: Theta, cause: Cause, value: float, other_values: Sequence[tuple[str, float]] = ()) -> Theta:
    """Return the model with that strength of a cause, its other parameters at usual values, and then `other_values`."""
    strength, *rest = coordinates_of(cause.name)
    usual = [(name, parameter.neutral) for name, parameter in zip(rest, cause.parameters[1:], strict=True)]
    for name, known in (*usual, (strength, value), *other_values):
        theta = theta.having(name, known)
    return theta


def two_sided(cause: Cause) -> bool:
    """Tell whether the strength may lie on either side of its neutral value."""
    return cause.strength.low < cause.strength.neutral < cause.strength.high
