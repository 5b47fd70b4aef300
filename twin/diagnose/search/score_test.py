"""Every cause of the catalogue against what is left of the data: how much would it gain, and can it be seen at all?

The score test of each candidate on the innovations, all recordings together, with what the parameters already in the
model can take up projected out.  A probe or two of each candidate instead of a fit, with the slopes of the model as it
is: exact enough to say which is worth a fit (tests/twin/diagnose/inference/test_derivatives.py).

Rule 1: the signature of a candidate is a secant to a small value of it, not a derivative: a limit has no derivative
        where it is not reached.
Rule 2: a candidate of whose signature less than VISIBLE is its own is not testable here, and said to be so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose import settings
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.theta import Theta, coordinates_of, derivative_step, moved
from twin.diagnose.search.probes import probes_of
from twin.estimation.innovations import information
from twin.estimation.optimiser import inverse
from twin.estimation.pace import Reuse
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.cause import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """One candidate."""

    cause: str
    probe: float  # value of the strength at which the signature was taken
    gain: float  # estimated increase of the log-likelihood
    step: float  # of the coordinate towards the maximum, in units of the probe
    z: float  # how far from absent, in standard errors, signed
    detectable: float  # standard errors by which the probe itself would show
    visible: float  # share of the signature that nothing in the model takes up
    beside: tuple[tuple[str, float], ...]  # moves of the other coordinates that go with a whole step
    chance: float = 0.0  # gain that the search for the cause's other parameters makes out of nothing
    phases_s: tuple[float, ...] = ()  # of a periodic force, as `Theta` has them
    others: tuple[tuple[str, float], ...] = ()  # values of the cause's other parameters, where not the usual ones

    @property
    def testable(self) -> bool:
        """Whether these data can show it."""
        return self.visible >= settings.VISIBLE and self.detectable >= settings.LEAST_INFORMATION * min(
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

    Of a part of the samples (`Criterion.thinner`) they are those that all samples would show.
    """
    present = {name.partition(".")[0] for name, _ in theta.causes}
    trials = [
        (cause, probe, shape)
        for cause in candidates
        if cause.name not in present and not cause.not_testable and cause.detector == "score-test"
        for probe in probes_of(cause, criterion.evidence.series)
        for shape in shapes_of(cause)
    ]
    run = criterion.run(theta)
    base, by_free = criterion.derivatives(theta, free, run, rough=True)
    k, count = len(free), len(free) + len(trials)
    change = np.empty((count, *base.shape))
    change[:k] = by_free
    beside = [probed(theta, cause, probe, shape) for cause, probe, shape in trials]
    # The slopes of a ball that may stick are not those of one that cannot.
    reuse = [Reuse.NONE if "sticks" in cause.traits else Reuse.SLOPES for cause, *_ in trials]
    outs = criterion.beside(beside, run, reuse)
    for place, out in enumerate(outs, k):
        np.subtract(out, base, out=change[place])
    del outs
    fisher, each = np.zeros((count, count)), np.empty((len(base), count))
    information(base, change, each, fisher)
    by = [derivative_step(theta, name, criterion.plant) for name in free]
    moves = [moved(theta, name, step, criterion.plant) for name, step in zip(free, by, strict=True)]
    score, curvature = criterion.outside_slopes(theta, [*moves, *beside], [*by, *(1.0 for _ in trials)])
    score, fisher = each.sum(axis=0) + score, fisher + curvature
    inner = inverse(fisher[:k, :k])
    best: dict[str, Score] = {}
    for place, (cause, probe, shape) in enumerate(trials, k):
        cross = fisher[:k, place]
        own = float(fisher[place, place])
        left = own - float(cross @ inner @ cross)
        slope = float(score[place] - cross @ inner @ score[:k])
        if not (own > 0.0 and math.isfinite(own)):
            continue
        left = max(left, 1e-12 * own)
        step = slope / left
        if step < 0.0 and not _two_sided(cause):
            gain, step = 0.0, 0.0
        else:
            gain = 0.5 * slope * slope / left
        found = Score(
            cause=cause.name,
            probe=probe,
            gain=gain / criterion.share,
            step=step,
            z=slope / math.sqrt(left * criterion.share),
            detectable=math.sqrt(left / criterion.share),
            visible=left / own,
            beside=tuple(zip(free, (-(inner @ cross)).tolist(), strict=True)),
            others=shape,
        )
        if cause.name not in best or found.gain > best[cause.name].gain:
            best[cause.name] = found
    return sorted(best.values(), key=lambda found: -found.gain)


def shapes_of(cause: Cause) -> list[tuple[tuple[str, float], ...]]:
    """The coordinates of the forms that are looked at; () for the usual one."""
    forms = [form for form in cause.forms if form.probed]
    return [
        (),
        *(
            tuple((f"{cause.name}.{name}", value) for name, value in form.values.items() if not isinstance(value, str))
            for form in forms
        ),
    ]


def probed(theta: Theta, cause: Cause, value: float, others: Sequence[tuple[str, float]] = ()) -> Theta:
    """With that strength of a cause, its other parameters at their usual values, and then `others`."""
    strength, *rest = coordinates_of(cause.name)
    usual = [(name, parameter.neutral) for name, parameter in zip(rest, cause.parameters[1:], strict=True)]
    for name, known in (*usual, (strength, value), *others):
        theta = theta.having(name, known)
    return theta


def _two_sided(cause: Cause) -> bool:
    strength = cause.strength
    return math.isfinite(strength.neutral) and strength.low < strength.neutral < strength.high
