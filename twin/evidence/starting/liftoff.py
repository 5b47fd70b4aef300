"""K_c from statics: from the current at lift-off, and from recorded equilibria.

At rest m g = K_c i^2 / (x_max - x)^2 (8), for any x.

Rule: the first sample at which x has visibly moved is later than the lift-off t_0, and its current is higher.  After
      t_0 the linearised (6) gives under a rising current

          x - x_0 = c / w^3 (sinh w tau - w tau),   tau = t - t_0,   w^2 = 2 g / gap,   c = 2 g (di/dt) / i

      t_0 is fitted to the first part of the flight.  i_c(t_0) comes from a straight line through the samples before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from protocol.campaign import Plant
from twin.distributions import robust_spread
from twin.estimation.record import FloatArray, Record, runs
from twin.settings import identification as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class LiftOff:
    """A lift-off, or a row of an equilibria file."""

    recording: str
    t_s: float
    gap_m: float
    i_c_a: float
    K_c: float
    relative_error: float  # of K_c, one sigma


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceConstant:
    """K_c from all points."""

    K_c: float
    std: float
    points: tuple[LiftOff, ...]
    scatter: float  # relative, of the single values
    shift_m: float | None  # height above x_max at which the line of currents is zero; None with fewer than 3 points
    shift_std_m: float = 0.0


def lift_offs(records: list[Record], plant: Plant) -> list[LiftOff]:
    """Find all lift-offs in the sawtooth recordings; each gives K_c by (8)."""
    return [point for record in records if record.kind == "sawtooth" for point in _departures(record, plant)]


def equilibria(records: list[Record], plant: Plant) -> list[LiftOff]:
    """Return all rows of the equilibria recordings; each gives K_c by (6) at rest."""
    points = []
    for record in records:
        if record.kind != "equilibria":
            continue
        for n in range(len(record.x)):
            gap, i = plant.x_max_m - float(record.x[n]), float(record.i_c[n])
            if np.isfinite(gap) and gap > 0 and np.isfinite(i) and i > 0:
                points.append(
                    LiftOff(
                        recording=record.name,
                        t_s=float(record.t[n]),
                        gap_m=gap,
                        i_c_a=i,
                        K_c=_constant(plant, gap, i),
                        relative_error=0.005,  # readings of three digits
                    )
                )
    return points


def force_constant(points: list[LiftOff], plant: Plant) -> ForceConstant | None:
    """Return K_c as the median of all points, with a standard error from their scatter and errors; None without any."""
    if not points:
        return None
    values = np.array([point.K_c for point in points])
    # The median: one ball that stuck, or was pushed, must not move it.
    K_c = float(np.median(values))
    error = float(np.sqrt(np.mean([point.relative_error**2 for point in points])))
    scatter = robust_spread(values / K_c - 1.0) if len(values) > 2 else 0.0
    if len(values) > 2:
        scatter = max(scatter, float(np.std(values / K_c, ddof=1)) / 2.0)
    gaps = np.array([point.gap_m for point in points])
    shift, shift_std = None, 0.0
    if len(points) >= 3 and np.ptp(gaps) > 0.1 * plant.travel_m:
        # By (8) the currents lie on a line through zero at gap = 0.
        columns = np.column_stack((gaps, np.ones(len(gaps))))
        currents = np.array([point.i_c_a for point in points])
        solution, *_ = np.linalg.lstsq(columns, currents, rcond=None)
        residual = currents - columns @ solution
        sigma = float(np.sqrt(residual @ residual / max(len(gaps) - 2, 1)))
        covariance = sigma**2 * np.linalg.inv(columns.T @ columns)
        shift = float(solution[1] / solution[0])
        # The error of a ratio, to first order.
        gradient = np.array([-solution[1] / solution[0] ** 2, 1.0 / solution[0]])
        shift_std = float(np.sqrt(gradient @ covariance @ gradient))
    return ForceConstant(
        K_c=K_c,
        std=K_c * 1.2533 * float(np.hypot(error, scatter)) / float(np.sqrt(len(values))),
        points=tuple(points),
        scatter=scatter,
        shift_m=shift,
        shift_std_m=shift_std,
    )


def _constant(plant: Plant, gap: float, i: float) -> float:
    return plant.mass_kg * plant.gravity_m_s2 * gap**2 / i**2


def _departures(record: Record, plant: Plant) -> list[LiftOff]:
    good = np.isfinite(record.x) & np.isfinite(record.i_c) & np.isfinite(record.t)
    good[1:] &= np.diff(record.t) > 0.0
    t, x, i = record.t[good], record.x[good], record.i_c[good]
    if len(t) < 20:
        return []
    step = float(np.median(np.diff(t)))
    width = max(round(0.1 / step), 8)
    noise = max(robust_spread(np.diff(x)) / np.sqrt(2.0), 1e-7)
    jump = np.zeros(len(x))
    jump[width:] = x[width:] - x[:-width]
    moved = jump > max(0.1 * plant.travel_m, 20.0 * noise)  # a tenth of a second later the ball is far away
    points: list[LiftOff] = []
    track = _Track(record.name, t, x, i, noise, step)
    for rise in runs(np.asarray(moved)):
        point = _departure(track, max(rise.start - 2 * width, 0), rise.start, plant)
        if point is not None and not (points and point.t_s - points[-1].t_s < 5 * width * step):
            points.append(point)
    return points


class _Track(NamedTuple):
    """The good samples of a recording."""

    name: str
    t: FloatArray
    x: FloatArray
    i: FloatArray
    noise_m: float  # of x
    step_s: float  # median sampling interval


def _departure(track: _Track, first: int, last: int, plant: Plant) -> LiftOff | None:
    """Find the lift-off between two samples of a track."""
    name, t, x, i, noise, step = track
    if last - first < 12:
        return None
    rest = float(np.median(x[first : first + (last - first) // 2]))
    rest_scatter = robust_spread(x[first : first + (last - first) // 2] - rest)
    if rest_scatter > 5.0 * noise + 1e-3 * plant.travel_m:
        return None  # it was not at rest
    above = np.flatnonzero(x[first:] > rest + settings.DEPARTURE_ERRORS * max(noise, rest_scatter))
    if not above.size:
        return None
    departure = first + int(above[0])
    gap = plant.x_max_m - rest
    if gap <= 0.02 * plant.travel_m:
        return None
    begin = max(departure - max(round(settings.LINE_S / step), 10), 0)
    slope, i_departure = np.polyfit(t[begin:departure] - t[departure], i[begin:departure], 1)
    scatter_i = float(np.std(i[begin:departure] - i_departure - slope * (t[begin:departure] - t[departure])))
    if not (slope > 0 and i_departure > 0):
        return None
    end = departure
    while end < len(x) - 1 and x[end] - rest < settings.LINEAR_SHARE * plant.travel_m and end - departure < 200:
        end += 1
    end = max(end, departure + 2)
    tau, rise = t[begin:end] - t[departure], x[begin:end] - rest
    t_0 = _instant(tau, rise, slope, i_departure, step, plant.gravity_m_s2, gap)
    current = i_departure + slope * t_0
    # An error of half a sampling interval in t_0, and the error of the line.
    error = float(np.hypot(0.5 * step * slope, scatter_i * 2.0 / np.sqrt(max(departure - begin, 1))))
    return LiftOff(
        recording=name,
        t_s=float(t[departure] + t_0),
        gap_m=gap,
        i_c_a=float(current),
        K_c=_constant(plant, gap, float(current)),
        relative_error=2.0 * error / float(current),
    )


def _instant(
    tau: FloatArray, rise: FloatArray, slope: float, i_departure: float, step: float, gravity: float, gap: float
) -> float:
    """Fit t_0 of the rule, in s after the departure, to the first part of the flight."""
    from scipy.optimize import minimize_scalar  # here: it takes 18 MB, and the running twin fits no lift-off

    w = float(np.sqrt(2.0 * gravity / gap))

    def misfit(t_0: float) -> float:
        current = i_departure + slope * t_0
        if current <= 0:
            return float("inf")
        c = 2.0 * gravity * slope / current
        elapsed = np.clip(tau - t_0, 0.0, 40.0 / w)
        return float(np.sum((rise - c / w**3 * (np.sinh(w * elapsed) - w * elapsed)) ** 2))

    lowest = -min(6.0 / w, -float(tau[0]))
    grid = np.linspace(lowest, step, 80)
    k = int(np.argmin([misfit(g) for g in grid]))
    bounds = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    return float(minimize_scalar(misfit, bounds=bounds, method="bounded").x)
