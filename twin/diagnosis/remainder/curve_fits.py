"""The curves that are fitted with the causes: their range, expected gain, and fit by the same likelihood."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X
from twin.estimation.record import BoolArray, FloatArray
from twin.evidence.gather import Evidence
from twin.inference.fisher_scoring import Fit, approach, climb
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import inverse
from twin.inference.theta import Theta, moved, parameter_of, prior_spread
from twin.model.causes.cause import Cause
from twin.model.causes.curve import COEFFICIENTS
from twin.settings import diagnosis as settings

_SLOPE_SAMPLES = 2  # on either side, for the speed


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveScore:
    """The gain of a curve by the score test (Rao, 1948), all its coefficients at once."""

    curve: Cause
    evidence: float  # gain of log-likelihood with the coefficients integrated out, by Laplace's method
    zero: Theta  # with the curve, which is 0
    step: tuple[float, ...]  # of its coefficients, were the likelihood a parabola


def coefficients(curve: Cause) -> tuple[str, ...]:
    """The coordinates of a curve that are fitted: all but the ends of its range."""
    return tuple(f"{curve.name}.{parameter.name}" for parameter in curve.shapes)


def visited(evidence: Evidence) -> dict[str, FloatArray]:
    """Return x, v, i and u of the samples in flight, each of shape (n,) with its own n: what curves are functions of.

    The speed is a difference of readings a few samples apart, where they follow one another.
    """
    series = evidence.series
    flies: BoolArray = series.flags & FLIES != 0
    follows = flies & (series.flags & FOLLOWS != 0)
    has_x, has_i = (flies & (series.flags & flag != 0) for flag in (USE_X, USE_I))
    n, reach = len(series), _SLOPE_SAMPLES
    inner = np.roll(has_x, reach) & np.roll(has_x, -reach)
    inner[:reach] = inner[max(n - reach, 0) :] = False
    for shift in range(1 - reach, reach + 1):
        inner &= np.roll(follows, -shift)
    # A difference over four intervals: one interval is mostly noise, and a filter's speed would be that of the wrong
    # model.
    (middle,) = np.nonzero(inner)
    duration = sum((series.step[middle + shift] for shift in range(1 - reach, reach + 1)), np.zeros(len(middle)))
    speed = (series.x[middle + reach] - series.x[middle - reach]) / duration
    return {"x": series.x[has_x], "v": speed, "i": series.i[has_i], "u": series.u[flies]}


def with_range(theta: Theta, curve: Cause, values: Mapping[str, FloatArray]) -> Theta:
    """Return theta with a curve that is 0 over the range of its quantity in `values`, of `visited`."""
    # Quantiles, not extremes: a single reading far out would stretch the knots over a range without data.
    ends = np.nanquantile(values[quantity_of(curve)], (settings.CURVE_OUTER, 1.0 - settings.CURVE_OUTER)).tolist()
    for parameter, end in zip(curve.parameters[:2], ends, strict=True):
        theta = theta.having(f"{curve.name}.{parameter.name}", float(end))
    for name in coefficients(curve):
        theta = theta.having(name, 0.0)
    return theta


def scores(criterion: Criterion, at: Fit, curves: Sequence[Cause]) -> list[CurveScore]:
    """The curves beside `at`, best first; those whose quantity hardly moves are left out."""
    values = visited(criterion.evidence)
    curves = [curve_ for curve_ in curves if _moves(values[quantity_of(curve_)])]
    if not curves:
        return []
    theta = at.theta
    for curve in curves:
        theta = with_range(theta, curve, values)
    names = (*at.free, *(name for curve in curves for name in coefficients(curve)))
    run = criterion.run(theta)
    # Rough derivatives suffice: the score only ranks the curves, and a fit of the best of them decides.
    outputs, change = criterion.derivatives(theta, names, run, rough=True)
    _, score, fisher = criterion.slopes(theta, names, outputs, change)
    k = len(at.free)
    known = inverse(fisher[:k, :k])
    results = []
    for number, curve in enumerate(curves):
        # (S 8) for eight numbers at once.  One by one they would share what they explain, as neighbouring splines
        # overlap.
        block = slice(k + number * COEFFICIENTS, k + (number + 1) * COEFFICIENTS)
        cross = fisher[block, :k] @ known
        left = fisher[block, block] - cross @ fisher[:k, block]  # with the information of the prior
        slope = score[block] - cross @ score[:k]
        step = np.linalg.solve(left, slope)
        widths = np.array([prior_spread(name) for name in coefficients(curve)])
        # The coefficients are integrated out: by the maximum alone a curve would always gain, as it has eight numbers.
        _, logarithm = np.linalg.slogdet(left * np.outer(widths, widths))
        # Laplace's method (R. E. Kass, A. E. Raftery, Journal of the American Statistical Association 90, 1995).
        evidence = 0.5 * float(slope @ step) - 0.5 * float(logarithm)
        zero = with_range(at.theta, curve, values)
        results.append(CurveScore(curve=curve, evidence=evidence, zero=zero, step=tuple(step.tolist())))
    return sorted(results, key=lambda curve_: -curve_.evidence)


def roughly_fitted(criterion: Criterion, at: Fit, score: CurveScore, *, goal: float = -math.inf) -> Fit:
    """Fit `at` with a curve again, not to the end: near enough to decide which predicts better.

    The fit ends even earlier where it will not come near the log-likelihood `goal`.
    """
    # The step of a very wrong model may lead to where nothing flies, and from there no fit returns.
    starts = [_with_part(criterion, score, part) for part in settings.START_PARTS]
    start = starts[int(np.argmax(criterion.thinner.values(starts)))]
    fit = approach(criterion, start, (*at.free, *coefficients(score.curve)))
    return climb(criterion, fit.theta, fit.free, passes=settings.CURVE_PASSES, approximate=True, goal=goal)


def _with_part(criterion: Criterion, score: CurveScore, part: float) -> Theta:
    theta = score.zero
    for name, change in zip(coefficients(score.curve), score.step, strict=True):
        theta = moved(theta, name, part * change, criterion.plant)
    return theta


def fully_fitted(criterion: Criterion, fit: Fit) -> Fit:
    """The same, fitted to the end."""
    return climb(criterion, fit.theta, fit.free, passes=settings.CURVE_PASSES, tolerance=settings.CURVE_TOLERANCE)


def band(fit: Fit, curve: Cause, at: FloatArray, weights_at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return g and its standard error, each of shape (n,), about its mean over the values that were visited.

    A constant share of the magnetic force is K_c under another name, and one of the weight nearly is.  So only the
    variation of a curve means anything.

    Args:
        fit: the fit with the curve free.
        curve: the curve.
        at: the arguments of the curve, shape (n,), in their unit.
        weights_at: the values that were visited.
    """
    low, high = (fit.theta.value(f"{curve.name}.{parameter.name}") for parameter in curve.parameters[:2])
    names = coefficients(curve)
    units = np.array([abs(parameter_of(name).probes[0]) for name in names])
    k = np.array([fit.theta.value(name) for name in names])
    indices = [fit.free.index(name) for name in names]
    covariance = fit.covariance[np.ix_(indices, indices)] * np.outer(units, units)
    rows = basis((at - low) / (high - low)) - basis((weights_at - low) / (high - low)).mean(axis=0)
    return rows @ k, np.sqrt(np.maximum(np.einsum("nj,jk,nk->n", rows, covariance, rows), 0.0))


def basis(share: FloatArray) -> FloatArray:
    """The cubic B-splines of `curve.py` at shares of the range, shape (n, COEFFICIENTS)."""
    from scipy.interpolate import BSpline

    # (S 12), uniform knots (P. H. C. Eilers, B. D. Marx, Statistical Science 11(2), 1996).  Knots at quantiles
    # would be fine where the ball hovers, and coarse where it seldom is.
    knots = np.arange(-3, COEFFICIENTS + 1, dtype=np.float64) / (COEFFICIENTS - 3)
    splines = BSpline(knots, np.eye(COEFFICIENTS), 3, extrapolate=False)
    return np.asarray(splines(np.clip(share, 0.0, 1.0 - 1e-12)))


def quantity_of(curve: Cause) -> str:
    """The quantity that a curve is a function of, as `visited` names it."""
    return curve.parameters[0].name.removeprefix("from_")


def _moves(values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    outer = settings.CURVE_OUTER
    return len(known) > 0 and float(np.ptp(np.quantile(known, (outer, 1.0 - outer)))) > 0.0
