"""Points of rest alone: what the force balance gets wrong, and which causes would put it right.

A campaign of kind `equilibria` has currents i_c at which the ball rested at heights x.  There m g = F_m (i_c, x)
by (3), and nothing moves.  The points test the balance, and the sensors through which it is seen.

Rule 1: the residual is in i_c, at the x that was read, A.  x was chosen, i_c is what the rig answered.
Rule 2: the noise is unknown and the points are few: F tests and intervals that are exact for that, never a chi-square.
Rule 3: each cause is fitted together with K_c, by the extended model's own force and sensors.
Rule 4: a cause that only shows in motion, or only in how i_c follows u_c, is not testable here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq, least_squares

from protocol.campaign import Plant
from protocol.errors import DataError
from twin.distributions import fisher_above, fisher_quantile
from twin.estimation.record import FloatArray, Record
from twin.inference.theta import Theta
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.equilibrium import holding_current
from twin.model.extended import current_reading
from twin.settings import diagnosis as settings

_STARTS = (-8.0, -1.0, 1.0, 8.0)  # times the first probe


@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """The rows, shape (n,) each."""

    x_m: FloatArray
    i_c_a: FloatArray
    u_c_v: FloatArray | None
    names: tuple[str, ...]  # the recording of each row

    def __len__(self) -> int:
        return len(self.x_m)

    def without(self, row: int) -> Points:
        """Return all rows but one."""
        keep = np.arange(len(self)) != row
        return Points(
            x_m=self.x_m[keep],
            i_c_a=self.i_c_a[keep],
            u_c_v=None if self.u_c_v is None else self.u_c_v[keep],
            names=tuple(name for name, retained in zip(self.names, keep, strict=True) if retained),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticFit:
    """K_c, and at most one cause, at their least squares."""

    cause: str  # "" for (3) alone
    theta: Theta
    rss_a2: float
    residual_a: FloatArray  # i_c measured - predicted
    freedom: int
    at_bound: bool = False

    @property
    def std_a(self) -> float:
        """Estimate the standard deviation of the noise from the residuals, A."""
        return math.sqrt(self.rss_a2 / self.freedom) if self.freedom > 0 else math.nan


def points_of(records: Sequence[Record], plant: Plant, min_points: int = settings.STATIC_POINTS) -> Points:
    """Return the points of rest in equilibria recordings.

    Raises:
        DataError: a row that cannot be a point of rest of this plant, or fewer than `min_points` rows.
    """
    channels = ("x", "i_c", "u_c")
    x, i, u = (np.concatenate([np.empty(0), *(getattr(r, name) for r in records)]) for name in channels)
    names = [record.name for record in records for _ in range(len(record.x))]
    for row, name in enumerate(names):
        if np.isfinite(x[row]) and not -0.2 * plant.travel_m <= x[row] <= 1.2 * plant.travel_m:
            raise DataError(
                f"{name}: x is {x[row]:.4g} m, and the ball can be at 0 to {plant.travel_m:g} m",
                remedy="Write x in m, up from the sensor: x = { column = ..., scale = ..., offset = ... }",
            )
        if np.isfinite(i[row]) and i[row] <= 0.0:
            raise DataError(
                f"{name}: i_c is {i[row]:.4g} A, which cannot hold the ball", remedy="Write i_c in A, positive upwards"
            )
    good = np.isfinite(x) & np.isfinite(i)
    if good.sum() < min_points or (min_points > 1 and np.ptp(x[good]) < 0.05 * plant.travel_m):
        raise DataError(
            f"{good.sum()} points of rest over {np.ptp(x[good]) * 1e3 if good.any() else 0.0:.2g} mm are too few",
            remedy=f"Hold the ball at {settings.STATIC_POINTS} heights or more, spread over the travel",
        )
    return Points(
        x_m=x[good],
        i_c_a=i[good],
        u_c_v=u[good] if np.isfinite(u[good]).all() else None,
        names=tuple(name for name, retained in zip(names, good, strict=True) if retained),
    )


def start(points: Points, plant: Plant) -> Theta:
    """Return (3) through the point in the middle; numbers that points of rest do not determine only fill the model."""
    gap = np.maximum(plant.x_max_m - points.x_m, 1e-3 * plant.travel_m)
    # (8) at each point; the median, as one wrong row must not move the start.
    K_c = plant.mass_kg * plant.gravity_m_s2 * float(np.median(gap / points.i_c_a)) ** 2
    K_A = 1.0 if points.u_c_v is None else float(np.median(points.i_c_a / points.u_c_v))
    return Theta(
        K_A=K_A,
        T_A=1e-3,
        K_c=K_c,
        b=0.0,
        sigma_i_c_a=1e-3,
        sigma_x_m=1e-6,
        process_i_c_a=0.0,
        process_a_m_s2=0.0,
    )


def holding_currents(theta: Theta, plant: Plant, x_m: FloatArray) -> FloatArray:
    """The i_c that is read while the ball rests where x is read, A, shape (n,); NaN where no current holds it."""
    p, c = theta.base(plant), theta.vector()
    shift = added_current(theta)
    return np.array([current_reading(c, holding_current(p, c, float(x), as_reading=True)) - shift for x in x_m])


def added_current(theta: Theta) -> float:
    """Return the current that an amplifier adds, A: it flows, but a current computed as K_A u_c lacks it."""
    return sum(
        cause.added_a(theta.value(strength_of(cause.name)), theta.K_A)
        for cause in CATALOGUE
        if cause.added_a is not None
    )


def fit_static(points: Points, plant: Plant, cause: str = "") -> StaticFit:
    """Return K_c and the strength of one cause by least squares in i_c."""
    begin = start(points, plant)
    if not cause:
        return _climb(points, plant, begin, cause, (math.log(begin.K_c),))
    unit, strength = _unit(cause), BY_NAME[cause].strength
    starts = [value for value in (strength.value(step * unit) for step in _STARTS) if value != strength.neutral]
    # From both sides and two distances, as least squares end in the nearest minimum; the deepest is kept.
    fits = []
    for value in dict.fromkeys(starts):
        at = begin.having(strength_of(cause), value)
        fits.append(_climb(points, plant, at, cause, (math.log(begin.K_c), strength.coordinate(value) / unit)))
    return min(fits, key=lambda fit: fit.rss_a2)


def refit(points: Points, plant: Plant, initial: StaticFit) -> StaticFit:
    """The same to other points, from a fit that is near."""
    begin: tuple[float, ...] = (math.log(initial.theta.K_c),)
    if initial.cause:
        strength = BY_NAME[initial.cause].strength
        begin += (strength.coordinate(initial.theta.value(strength_of(initial.cause))) / _unit(initial.cause),)
    return _climb(points, plant, initial.theta, initial.cause, begin)


def fit_gain(points: Points, plant: Plant, cause: str, value: float, initial: Theta) -> StaticFit:
    """Return K_c alone, the cause's strength held at `value`."""
    at = initial.having(strength_of(cause), value)
    fit = _climb(points, plant, at, cause, (math.log(initial.K_c),))
    return replace(fit, freedom=len(points) - 2)


def is_absorbed(points: Points, plant: Plant, base: StaticFit, cause: str) -> bool:
    """Return whether K_c makes up for any strength of this cause: the points then say nothing about it."""
    strength = BY_NAME[cause].strength
    values = [strength.value(step * _unit(cause)) for step in (-10.0, 10.0)]
    held = [fit_gain(points, plant, cause, value, base.theta).rss_a2 for value in values if value != strength.neutral]
    return all(abs(rss - base.rss_a2) < 0.01 * base.rss_a2 for rss in held)


def interval(points: Points, plant: Plant, fit: StaticFit) -> tuple[float, float]:
    """Return the exact-level 95 % interval of the cause's strength by its profile: unknown noise, F(1, n - 2).

    An end is the physical range's where the data set none before it.
    """
    strength = BY_NAME[fit.cause].strength
    best = strength.coordinate(fit.theta.value(strength_of(fit.cause)))
    # The profile with F(1, n - 2) (D. M. Bates, D. G. Watts, Nonlinear Regression Analysis and Its Applications,
    # 1988).  A linearised interval would be wrong for a cause that bends the curve.
    limit = fit.rss_a2 * (1.0 + float(fisher_quantile(1.0 - settings.STATIC_LEVEL, 1, fit.freedom)) / fit.freedom)
    ends = []
    for edge in sorted(_edges(fit.cause)):
        sign = 1.0 if edge > best else -1.0

        def over(distance: float, sign: float = sign) -> float:
            held = fit_gain(points, plant, fit.cause, strength.value(best + sign * distance), fit.theta)
            return held.rss_a2 - limit if math.isfinite(held.rss_a2) else 1.0

        reach = abs(edge - best)
        far = min(1e-3 * max(abs(best), _unit(fit.cause)), reach)
        while far < reach and over(far) < 0.0:
            far = min(2.0 * far, reach)
        ends.append(edge if over(far) < 0.0 else best + sign * float(brentq(over, 0.0, far, rtol=1e-3)))
    low, high = sorted(strength.value(end) for end in ends)
    return low, high


def standard_error(points: Points, plant: Plant, fit: StaticFit, *, of_gain: bool = False) -> float:
    """Return the standard error of the cause's strength in its own unit, or of ln K_c; linearised."""
    moves = [replace(fit.theta, K_c=fit.theta.K_c * (1.0 + 1e-4))]
    steps = [1e-4]
    if fit.cause:
        strength, name = BY_NAME[fit.cause].strength, strength_of(fit.cause)
        value, change = fit.theta.value(name), 1e-3 * _unit(fit.cause)
        # Inwards at the end of its range, where a step outwards moves nothing.
        if strength.value(strength.coordinate(value) + change) == value:
            change = -change
        moves.append(fit.theta.having(name, strength.value(strength.coordinate(value) + change)))
        steps.append(moves[-1].value(name) - value)
    now = holding_currents(fit.theta, plant, points.x_m)
    columns = [
        (holding_currents(at, plant, points.x_m) - now) / change for at, change in zip(moves, steps, strict=True)
    ]
    gram = np.array(columns) @ np.array(columns).T
    covariance = np.linalg.pinv(gram, rcond=1e-12) * fit.std_a**2
    index = 0 if of_gain or not fit.cause else 1
    return math.sqrt(max(float(covariance[index, index]), 0.0))


def f_test(base: StaticFit, fit: StaticFit) -> tuple[float, float]:
    """Return (F, probability that chance alone gains as much) of one more parameter under unknown Gaussian noise."""
    if fit.freedom <= 0:
        return math.nan, 1.0
    # The F test of nested models (G. A. F. Seber, C. J. Wild, Nonlinear Regression, 1989).  The noise is unknown,
    # so a chi-square would need a level that nobody measured.
    ratio = (base.rss_a2 - fit.rss_a2) / max(fit.rss_a2 / fit.freedom, 1e-300)
    return ratio, float(fisher_above(max(ratio, 0.0), 1, fit.freedom))


def left_out(points: Points, plant: Plant, whole: StaticFit) -> FloatArray:
    """Return i_c measured - predicted of each point by the model fitted to the others, A, shape (n,)."""
    errors = np.full(len(points), np.nan)
    for row in range(len(points)):
        # M. Stone, Cross-validatory choice and assessment of statistical predictions, 1974.  The points are too few to
        # keep some apart.
        fit = refit(points.without(row), plant, whole)
        errors[row] = points.i_c_a[row] - holding_currents(fit.theta, plant, points.x_m[row : row + 1])[0]
    return errors


def rounding(values: FloatArray) -> float:
    """The step to which these numbers are rounded; 0 where no decimal step of six digits fits them."""
    for digits in range(7):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) < 1e-6 + 1e-12 * np.abs(scaled)):
            return float(10.0**-digits)
    return 0.0


def computed_current(points: Points) -> float | None:
    """The constant by which i_c is u_c, where it was computed and not measured; else None."""
    if points.u_c_v is None or np.ptp(points.u_c_v) == 0.0:
        return None
    ratio = points.i_c_a / points.u_c_v
    return float(ratio.mean()) if np.ptp(ratio) < 2e-5 * ratio.mean() else None


def _climb(points: Points, plant: Plant, at: Theta, cause: str, begin: tuple[float, ...]) -> StaticFit:
    def theta_of(z: FloatArray) -> Theta:
        theta = replace(at, K_c=math.exp(min(max(float(z[0]), -60.0), 10.0)))
        return (
            theta
            if len(z) == 1
            else theta.having(strength_of(cause), BY_NAME[cause].strength.value(float(z[1]) * _unit(cause)))
        )

    def residual(z: FloatArray) -> FloatArray:
        off = points.i_c_a - holding_currents(theta_of(z), plant, points.x_m)
        return np.where(np.isfinite(off), off, 1e3)

    low, high = [-60.0], [10.0]
    if len(begin) > 1:
        edges = sorted(edge / _unit(cause) for edge in _edges(cause))
        low.append(edges[0])
        high.append(edges[1])
    inner = [min(max(z, a + 1e-9), b - 1e-9) for z, a, b in zip(begin, low, high, strict=True)]
    solution = least_squares(residual, inner, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-14, max_nfev=300)
    off = residual(solution.x)
    at_bound = len(begin) > 1 and bool(min(solution.x[1] - low[1], high[1] - solution.x[1]) < 1e-6 * (high[1] - low[1]))
    return StaticFit(
        cause=cause,
        theta=theta_of(solution.x),
        rss_a2=float(off @ off),
        residual_a=off,
        freedom=len(points) - len(begin),
        at_bound=at_bound,
    )


def strength_of(cause: str) -> str:
    """Return the coordinate of a cause's strength."""
    return f"{cause}.{BY_NAME[cause].strength.name}"


def _unit(cause: str) -> float:
    strength = BY_NAME[cause].strength
    return abs(strength.coordinate(strength.probes[0]))


def _edges(cause: str) -> tuple[float, float]:
    """The physical range, as coordinates."""
    strength = BY_NAME[cause].strength
    if math.isinf(strength.neutral):
        return 0.0, strength.coordinate(strength.low)
    return strength.coordinate(strength.low), strength.coordinate(strength.high)
