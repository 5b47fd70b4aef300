"""The diagnosis of a campaign that has points of rest alone: verdict, class, what would split it, diagnosis.json.

Rule 1: causes are one class if an F test cannot tell their residuals from those of the best fit.
Rule 2: members of a class differ in the unstable pole at mid-travel, which any closed-loop flight shows.  Members with
        the same pole need another instrument.
Rule 3: without motion nothing is predicted 20 ms ahead.  Each point is predicted from the others, for the gain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from protocol.campaign import Campaign, Plant
from protocol.errors import DataError
from twin.diagnosis.equilibria.points import (
    Points,
    StaticFit,
    computed_current,
    f_test,
    fit_static,
    holding_currents,
    interval,
    is_absorbed,
    left_out,
    points_of,
    rounding,
    standard_error,
    strength_of,
)
from twin.diagnosis.judge.reference_model import check_plant, theta_of
from twin.distributions import fisher_quantile, student_quantile
from twin.estimation.record import FloatArray, Record
from twin.inference.theta import Theta
from twin.model.assumed import assumption_warning, mark
from twin.model.causes.catalogue import BY_NAME, CATALOGUE, measurement_for
from twin.model.linear import linearised
from twin.model.parameters import Model, ModelCause, Parameter, verdict_by
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings

_METHOD = "least squares in i_c over the points of rest"
Verdict = Literal["causes-found", "model-adequate", "unknown-cause"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """A cause that explains the points better than (3) alone."""

    name: str
    fit: StaticFit
    low: float  # 95 %
    high: float
    F: float  # of the F test against (3) alone
    p: float  # probability of so large an F by chance
    left_out_a: FloatArray  # error of each point, predicted from the others, A
    pole_per_s: float  # unstable pole at mid-travel of the model with this cause
    pole_std_per_s: float

    @property
    def value(self) -> float:
        """Return the fitted strength of the cause, in the unit of its first parameter."""
        return self.fit.theta.value(strength_of(self.name))


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticDiagnosis:
    """Everything found from points of rest."""

    plant: Plant
    points: Points
    base: StaticFit
    base_left_out_a: FloatArray
    base_off_m: FloatArray  # height at which (3) rests with the measured i_c, minus the measured height, m
    reference_off_a: FloatArray | None  # i_c measured - computed by the reference model, A
    members: tuple[Explanation, ...]  # of the class, best first; empty where nothing is named
    rejected: tuple[Explanation, ...]  # tested, and worse
    absorbed: tuple[str, ...]  # another K_c explains as much as these causes
    verdict: Verdict
    confidence: float
    rounding_a: float  # standard deviation that rounding alone gives i_c
    judge: tuple[FloatArray, FloatArray] | None  # i_c measured - predicted on judge points, before and after, A
    extended: Model
    warnings: tuple[str, ...]


def diagnose_points(
    campaign: Campaign,
    records: Sequence[Record],
    judges: Sequence[Record],
    *,
    model: Model | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> StaticDiagnosis:
    """Diagnose points of rest.

    Args:
        campaign: whose plant it is.
        records: for fitting, all of kind `equilibria`.
        judges: left out; only those of kind `equilibria` are used.
        model: the simulation to be judged beside (3) at its best.
        say: takes lines of progress.

    Raises:
        DataError: too few points, or points that this plant cannot have.
    """
    plant, points = campaign.plant, points_of(records, campaign.plant)
    warnings = [assumption_warning(plant)] if plant.assumed else []
    warnings += [note for record in records for note in record.notes]
    base = fit_static(points, plant)
    say(f"{len(points)} points of rest; (3) alone is off by {1e3 * base.std_a:.3g} mA")
    computed = computed_current(points)
    tested = ("balance",) if computed is None else ("balance", "amplifier")
    explained, absorbed = _explanations(points, plant, base, tested, say)
    possible = [explanation for explanation in explained if not explanation.fit.at_bound]
    round_a = rounding_of(points, computed)
    members, verdict, confidence = _verdict(possible, base, round_a, max(len(explained), 1))
    warnings += _remarks(points, computed)
    judge_points = _judge_points(judges, plant, warnings)
    after = members[0].fit if members else base
    judge = (_off(base.theta, plant, judge_points), _off(after.theta, plant, judge_points)) if judge_points else None
    better = bool(members) and _predicts_better(members[0], judge, points, plant, base)
    if members and not better:
        warnings.append(
            f"extended_model.json is (3) alone: {members[0].name} does not predict the left-out points better"
        )
    chosen, fit = (members, after) if better else ((), base)
    extended, assumed = _extended(campaign, fit, chosen, points, model, computed, base)
    warnings += assumed
    return StaticDiagnosis(
        plant=plant,
        points=points,
        base=base,
        base_left_out_a=left_out(points, plant, base),
        base_off_m=_as_heights(base, plant, points),
        reference_off_a=None if model is None else _off(theta_of(model, base.theta), plant, points),
        members=tuple(members),
        rejected=tuple(explanation for explanation in explained if explanation not in members),
        absorbed=tuple(absorbed),
        verdict=verdict,
        confidence=confidence,
        rounding_a=round_a,
        judge=judge,
        extended=extended,
        warnings=tuple(dict.fromkeys(warnings)),
    )


def _explanations(
    points: Points, plant: Plant, base: StaticFit, kinds: Sequence[str], say: Callable[[str], None]
) -> tuple[list[Explanation], list[str]]:
    """Return (what each cause of these kinds explains, best first; those that K_c takes up)."""
    explained, absorbed = [], []
    for name in [cause.name for kind in kinds for cause in CATALOGUE if cause.at_rest == kind]:
        say(f"trying {name}")
        fit = fit_static(points, plant, name)
        if base.rss_a2 - fit.rss_a2 < settings.STATIC_ABSORBED * base.rss_a2 and is_absorbed(points, plant, base, name):
            absorbed.append(name)
        else:
            explained.append(_explanation(points, plant, base, fit))
    return sorted(explained, key=lambda explanation: explanation.fit.rss_a2), absorbed


def _as_heights(base: StaticFit, plant: Plant, points: Points) -> FloatArray:
    """Return the residuals of the holding currents as heights, m, shape (n,)."""
    above = holding_currents(base.theta, plant, points.x_m + 1e-7)
    return base.residual_a / ((above - holding_currents(base.theta, plant, points.x_m)) / 1e-7)


def is_static(campaign: Campaign) -> bool:
    """Return whether every recording for fitting is of kind `equilibria`."""
    return {recording.kind for recording in campaign.recordings if recording.use == "fit"} == {"equilibria"}


def diagnose_static(
    campaign: Campaign, *, data: Path | None, model: Model | None, say: Callable[[str], None]
) -> StaticDiagnosis:
    """Diagnose points of rest.

    Raises:
        DataError: recordings that cannot be used, or a model of another plant.
    """
    if model is not None:
        check_plant(model, campaign.plant)
    records = read_campaign(campaign, data=data)
    judges = read_campaign(campaign, use="judge", data=data)
    return diagnose_points(campaign, records, judges, model=model, say=say)


def pole(theta: Theta, plant: Plant, reading_m: float) -> float:
    """The unstable pole (14) of the ball where x is read, at constant current, 1/s; NaN if it is stable or none rests.

    With the current held, the matrix of (14) has the rows and columns of x and its speed alone.
    """
    mechanics = linearised(theta.base(plant), theta.vector(), reading_m)[0][1:3, 1:3]
    fastest = float(np.linalg.eigvals(mechanics).real.max()) if np.isfinite(mechanics).all() else math.nan
    return fastest if fastest > 0.0 else math.nan


def rounding_of(points: Points, computed_a_v: float | None) -> float:
    """Return the standard deviation of i_c by the digits that it, or the u_c behind it, was written with, A."""
    if computed_a_v is not None and points.u_c_v is not None:
        return computed_a_v * rounding(points.u_c_v) / math.sqrt(12.0)
    return rounding(points.i_c_a) / math.sqrt(12.0)


def separation(first: Explanation, second: Explanation) -> float:
    """Return the standard errors by which a measured pole would tell the two apart."""
    # A measured pole is assumed to be right to one per cent, so that counts beside the errors of both fits.
    spread = math.hypot(first.pole_std_per_s, second.pole_std_per_s, 0.01 * first.pole_per_s)
    return abs(first.pole_per_s - second.pole_per_s) / spread


def proposal_for(first: Explanation, second: Explanation) -> tuple[str, float, str]:
    """Return (what to measure, separation in standard errors, command) to tell two members apart."""
    z = separation(first, second)
    if z >= settings.STATIC_Z:
        what = (
            f"fly wide steps in closed loop: the unstable pole at mid-travel is {first.pole_per_s:.1f} 1/s with"
            f" {first.name} and {second.pole_per_s:.1f} 1/s with {second.name}"
        )
        return what, z, "board51 campaign run FOLDER --experiment wide-steps"
    return measurement_for(first.name, second.name), z, ""


def _explanation(points: Points, plant: Plant, base: StaticFit, fit: StaticFit) -> Explanation:
    F, p = f_test(base, fit)
    low = high = pole_per_s = pole_std_per_s = math.nan
    left_out_a = np.full(len(points), math.nan)
    # One that will not be named is not measured: nobody asks how large it is.
    if not (p > settings.STATIC_LEVEL or fit.at_bound):
        low, high = interval(points, plant, fit)
        left_out_a = left_out(points, plant, fit)
        middle, coordinate = 0.5 * plant.travel_m, strength_of(fit.cause)
        moved = fit.theta.value(coordinate) + 0.1 * standard_error(points, plant, fit)
        pole_per_s = pole(fit.theta, plant, middle)
        change = pole(fit.theta.having(coordinate, moved), plant, middle) - pole_per_s
        pole_std_per_s = abs(change) * 10.0 if math.isfinite(change) else 0.0
    return Explanation(
        name=fit.cause,
        fit=fit,
        low=low,
        high=high,
        F=F,
        p=p,
        left_out_a=left_out_a,
        pole_per_s=pole_per_s,
        pole_std_per_s=pole_std_per_s,
    )


def _verdict(
    possible: Sequence[Explanation], base: StaticFit, round_a: float, tests: int
) -> tuple[list[Explanation], Verdict, float]:
    """Return (members of the class, verdict, confidence that it is one of them)."""
    if not possible or possible[0].p * tests > settings.STATIC_LEVEL:
        # Nothing earns a name.  (3) is only known to be wrong where it is off by more than rounding.
        rough = base.std_a > 3.0 * round_a > 0.0 and base.freedom > 0
        return [], "unknown-cause" if rough else "model-adequate", 0.0
    best = possible[0]
    # The ratio of two sums of squares.  A difference of likelihoods, as in the search, would need the noise to be
    # known.
    limit = float(fisher_quantile(1.0 - settings.STATIC_LEVEL, best.fit.freedom, best.fit.freedom))
    members = [
        explanation
        for explanation in possible
        if explanation.fit.rss_a2 <= limit * best.fit.rss_a2 and explanation.p * tests <= settings.STATIC_LEVEL
    ]
    order = {cause.name: index for index, cause in enumerate(CATALOGUE)}
    families = {"force": 0, "motion": 1, "sensing": 2, "amplifier": 3, "timing": 4}
    # Sums of squares within a per cent are the same to a handful of points.  Their order is then fixed by family, not
    # by the last digits.
    tied = [explanation for explanation in members if explanation.fit.rss_a2 <= settings.STATIC_TIE * best.fit.rss_a2]
    tied.sort(key=lambda explanation: (families[BY_NAME[explanation.name].family], order[explanation.name]))
    rest = [explanation for explanation in members if explanation not in tied]
    return [*tied, *rest], "causes-found", min(settings.STATIC_CONFIDENCE, 1.0 - min(best.p * tests, 1.0))


def _remarks(points: Points, computed: float | None) -> list[str]:
    remarks = ['no recording has use = "judge" and motion: each point is predicted from the others for the gain']
    if computed is not None:
        remarks.append(
            f"i_c is u_c times {computed:.4g} A/V in every row: it was computed, so an error of the amplifier"
            " looks like one of the current sensor"
        )
    if len(points) - 2 < 5:
        remarks.append(
            f"{len(points)} points leave {len(points) - 2} degrees of freedom beside K_c and one cause: too few for a"
            " second"
        )
    return remarks


def _judge_points(judges: Sequence[Record], plant: Plant, warnings: list[str]) -> Points | None:
    static = [record for record in judges if record.kind == "equilibria"]
    if len(static) < len(judges):
        warnings.append("judge recordings with motion are not used: points of rest do not show T_A and b")
    if not static:
        return None
    try:
        return points_of(static, plant, min_points=1)
    except DataError as error:
        warnings.append(f"judge points are not used: {error}")
        return None


def _predicts_better(
    first: Explanation,
    judge: tuple[FloatArray, FloatArray] | None,
    points: Points,
    plant: Plant,
    base: StaticFit,
) -> bool:
    """Return whether a cause reduces the error of unused points: the judges, else each point left out in turn."""
    before, after = judge or (left_out(points, plant, base), first.left_out_a)
    return float(np.sum(after**2)) < float(np.sum(before**2))


def _off(theta: Theta, plant: Plant, points: Points) -> FloatArray:
    return points.i_c_a - holding_currents(theta, plant, points.x_m)


def _extended(
    campaign: Campaign,
    fit: StaticFit,
    members: Sequence[Explanation],
    points: Points,
    model: Model | None,
    computed: float | None,
    base: StaticFit,
) -> tuple[Model, list[str]]:
    """Return (the model with the first member, what in it was not measured)."""
    plant = campaign.plant
    like = model or Model.load("ce152")
    origin = "of the model that was given" if model else "of the shipped CE 152"
    assumed = [f"K_A, T_A, b and the noise in extended_model.json are {origin}: points of rest do not determine them"]
    parameters = {
        name: replace(entry, std=None, ci95=None, verdict="assumed", method=f"{origin}; not in these data")
        for name, entry in like.parameters.items()
    }
    t = student_quantile(1.0 - settings.STATIC_LEVEL / 2.0, max(fit.freedom, 1))
    std = standard_error(points, plant, fit, of_gain=True) * fit.theta.K_c
    parameters["K_c"] = Parameter(
        value=fit.theta.K_c,
        unit="N m^2/A^2",
        std=std,
        ci95=(max(fit.theta.K_c - t * std, 1e-9), fit.theta.K_c + t * std),
        verdict=verdict_by(t * std, fit.theta.K_c),
        method=f"{_METHOD}, Student t with {fit.freedom} degrees of freedom",
        equation="(3)",
    )
    if computed is not None:
        parameters["K_A"] = Parameter(
            value=computed, unit="A/V", verdict="assumed", method="i_c of the points is u_c times this", equation="(1)"
        )
    causes = tuple(ModelCause(name=member.name, parameters=parameters_of(member)) for member in members[:1])
    return Model(
        plant=plant,
        parameters=mark(parameters, plant),
        noise=like.noise,
        causes=causes,
        provenance={
            "tool": "board51 diagnose",
            "about": "points of rest alone",
            "extends": "all-causes" if members else "reference",
            "judged": True,
            "recordings": sorted(set(points.names)),
            "rms_a": {"paper": math.sqrt(base.rss_a2 / len(points)), "extended": math.sqrt(fit.rss_a2 / len(points))},
        },
    ), assumed


def parameters_of(explanation: Explanation) -> dict[str, Parameter]:
    """Return the cause's parameters: the strength as fitted, the others at their usual values."""
    cause, half = BY_NAME[explanation.name], 0.5 * abs(explanation.high - explanation.low)
    parameters = {
        entry.name: Parameter(value=entry.neutral, unit=entry.unit, method="not in these data")
        for entry in cause.parameters
    }
    parameters[cause.strength.name] = Parameter(
        value=explanation.value,
        unit=cause.strength.unit,
        ci95=(explanation.low, explanation.high),
        verdict="identified" if half < 0.25 * abs(explanation.value) else "weak",
        method=f"{_METHOD}; interval by profile, F(1, {explanation.fit.freedom})",
        equation=cause.equation,
    )
    return parameters
