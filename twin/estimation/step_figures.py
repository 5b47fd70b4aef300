"""Step responses: rise time, settling time, overshoot, IAE and control effort of rig and simulation, and differences.

Rule 1: the same code measures rig and simulation; the simulation's figure is the mean over its realisations.
Rule 2: the difference is rig - simulation, paired step by step, with Student's interval over the steps.  A single step
        has no interval.  All figures of the same steps are one family of tests (`family.py`).
Rule 3: x is averaged over 10 ms before thresholds are applied.  The settling band is at least 4 standard deviations of
        the effect of noise, so that noise does not end a settling.  The band is reported with the figure.
Rule 4: with a band wider than 10 % there is no settling time.  The response would be inside before it has risen to
        90 %.  So a settling time is never shorter than the rise time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from twin.distributions import student_above, student_quantile
from twin.estimation.family import holm
from twin.estimation.record import FloatArray, runs

DWELL_S = 0.15  # a step is a change of the reference after which it is constant for this time
SMALLEST_SIGMAS = 20.0
BAND, WIDEST_BAND = 0.05, 0.10
SMOOTH_S = 0.01

# name: (title, unit, factor from SI)
FIGURES: dict[str, tuple[str, str, float]] = {
    "rise_s": ("rise time 10-90 %", "ms", 1e3),
    "settling_s": ("settling time", "ms", 1e3),
    "overshoot": ("overshoot", "%", 100.0),
    "iae_m_s": ("IAE", "µm s", 1e6),
    "effort_v2_s": ("control effort", "V² s", 1.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopRun:
    """A flight in closed loop; arrays have shape (n,), those of the simulation (realisations, n)."""

    name: str
    t_s: FloatArray
    x_ref_m: FloatArray
    x_m: FloatArray
    i_c_a: FloatArray
    u_c_v: FloatArray
    simulated_x_m: FloatArray
    simulated_i_c_a: FloatArray
    simulated_u_c_v: FloatArray
    quiet_x_m: FloatArray  # simulated without noise
    expected_std_m: float  # of measured - quiet under a right model; NaN if the model's loop is unstable

    @property
    def interval_s(self) -> float:
        """Return the sampling interval, s."""
        return float(np.median(np.diff(self.t_s)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A figure compared over all steps; SI units."""

    name: str
    rig: float
    simulation: float
    difference: float  # rig - simulation
    ci95: tuple[float, float] | None  # None: fewer than two steps
    chance: float = float("nan")  # p value of no difference, two-sided; NaN: fewer than two steps
    count: int  # steps in which both have the figure
    steps: int  # all steps
    rig_count: int  # steps in which the rig has it
    simulation_count: int  # steps in which every realisation has it
    bands: tuple[float, float] | None = None  # of a settling time: narrowest and widest, shares of the step
    too_small: int = 0  # steps too small for a settling time in this noise
    significant: bool = False  # whether the two differ, by `together`


@dataclass(frozen=True, slots=True, kw_only=True)
class RigFigure:
    """A figure of the rig over all its steps, without a simulation; SI units."""

    name: str
    rig: float
    ends: tuple[float, float]  # smallest and largest; the steps differ in size and height, so a mean has no interval
    count: int
    steps: int
    bands: tuple[float, float] | None = None  # as in Compared


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A step of the reference in a run."""

    begin: int
    end: int
    from_m: float
    to_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """A response, scaled to a step from 0 to 1 at t = 0; the simulation is the mean of its realisations."""

    t_s: FloatArray
    rig: FloatArray
    simulation: FloatArray


def changes(x_ref_m: FloatArray, T_s: float) -> list[tuple[slice, slice]]:
    """Return the (level before, level after) of each change of a reference that lasts less than half a second."""
    is_constant = np.concatenate(([True], np.abs(np.diff(x_ref_m)) < 1e-9))
    levels = runs(np.asarray(is_constant), max(round(DWELL_S / T_s) - 1, 2))
    # A longer way between two levels is a ramp and no step.
    return [(before, after) for before, after in pairwise(levels) if after.start - before.stop < 0.5 / T_s]


def find_steps(x_ref_m: FloatArray, T_s: float, sigma_x_m: float) -> list[Step]:
    """Return the changes of the reference (every T_s) between constant levels; `sigma_x_m` is the noise of x, m."""
    steps = []
    for before, after in changes(x_ref_m, T_s):
        low, high = float(x_ref_m[before.stop - 1]), float(x_ref_m[after.start])
        if abs(high - low) >= SMALLEST_SIGMAS * sigma_x_m:
            steps.append(Step(begin=before.stop, end=after.stop, from_m=low, to_m=high))
    return steps


def responses(loops: Sequence[LoopRun], sigma_x_m: float) -> list[Response]:
    """The scaled response to every step."""
    scaled = []
    for run in loops:
        quiet = run.simulated_x_m.mean(axis=0)
        for step in find_steps(run.x_ref_m, run.interval_s, sigma_x_m):
            part = slice(step.begin, step.end)
            size = step.to_m - step.from_m
            rig, simulation = ((x[part] - step.from_m) / size for x in (run.x_m, quiet))
            scaled.append(Response(t_s=run.t_s[part] - run.t_s[step.begin], rig=rig, simulation=simulation))
    return scaled


def compare_steps(loops: Sequence[LoopRun], sigma_x_m: float) -> tuple[Compared, ...]:
    """Compare all figures over all steps of all runs; empty without a step.  `sigma_x_m` is the noise of x, m."""
    rig: list[list[float]] = []
    simulation: list[list[float]] = []
    bands: list[float] = []
    for run in loops:
        T_s = run.interval_s
        noise = run.expected_std_m if np.isfinite(run.expected_std_m) else sigma_x_m
        for step in find_steps(run.x_ref_m, T_s, sigma_x_m):
            rig.append(measure(run.x_m, run.u_c_v, run.x_ref_m, step, T_s, noise))
            bands.append(settling_band(step.to_m - step.from_m, noise))
            several = [
                measure(x, u, run.x_ref_m, step, T_s, noise)
                for x, u in zip(run.simulated_x_m, run.simulated_u_c_v, strict=True)
            ]
            table = np.array(several)
            # A figure needs all realisations: the mean of those that settle would leave out the slow ones, and look too
            # good.
            known = np.isfinite(table).all(axis=0)
            simulation.append(list(np.where(known, np.where(known, table, 0.0).mean(axis=0), np.nan)))
    if not rig:
        return ()
    return together(
        [
            compared(name, np.array(rig)[:, n], np.array(simulation)[:, n], bands if name == "settling_s" else ())
            for n, name in enumerate(FIGURES)
        ]
    )


def together(rows: Sequence[Compared]) -> tuple[Compared, ...]:
    """The figures of the same steps with `significant`, decided as one family of tests."""
    significant = holm([row.chance for row in rows])
    return tuple(replace(row, significant=differs) for row, differs in zip(rows, significant, strict=True))


def _widths(bands: Sequence[float]) -> tuple[float, float] | None:
    """Return the narrowest and widest band that allowed a settling time."""
    usable = [band for band in bands if band <= WIDEST_BAND]
    return (min(usable), max(usable)) if usable else None


def rig_figures(loops: Sequence[LoopRun], sigma_x_m: float) -> tuple[RigFigure, ...]:
    """The figures of the rig alone; empty without a step."""
    rows, bands = [], []
    for run in loops:
        T_s = run.interval_s
        for step in find_steps(run.x_ref_m, T_s, sigma_x_m):
            rows.append(measure(run.x_m, run.u_c_v, run.x_ref_m, step, T_s, sigma_x_m))
            bands.append(settling_band(step.to_m - step.from_m, sigma_x_m))
    used = _widths(bands)
    return tuple(
        _rig_figure(name, np.array(rows)[:, n], used if name == "settling_s" else None)
        for n, name in enumerate(FIGURES if rows else ())
    )


def _rig_figure(name: str, values: FloatArray, bands: tuple[float, float] | None) -> RigFigure:
    known = values[np.isfinite(values)]
    n = len(known)
    none = float("nan")
    return RigFigure(
        name=name,
        rig=float(known.mean()) if n else none,
        ends=(float(known.min()), float(known.max())) if n else (none, none),
        count=n,
        steps=len(values),
        bands=bands,
    )


def measure(
    x: FloatArray,
    u: FloatArray,
    x_ref: FloatArray,
    step: Step,
    T_s: float,
    noise_m: float,
    *,
    smooth_s: float = SMOOTH_S,
) -> list[float]:
    """The figures of one step in the order of FIGURES; NaN for events outside the step.

    The rise time is from 10 % to 90 % of the step; the settling time counts from the first change of the reference
    until x stays within the band; overshoot is a share of the step; the effort is the integral of
    (u_c - its final level)^2.
    """
    part = slice(step.begin, step.end)
    size = step.to_m - step.from_m
    width = max(round(smooth_s / T_s), 1)
    values = x[part]
    known = np.isfinite(values)
    values = np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])
    # Padded by the end values: zeros would look like the ball leaving its level at both ends.
    padded = np.concatenate((np.full(width // 2, values[0]), values, np.full(width - 1 - width // 2, values[-1])))
    y = (np.convolve(padded, np.full(width, 1.0 / width), mode="valid") - step.from_m) / size
    band = settling_band(size, noise_m)
    in_band = np.abs(y - 1.0) <= band
    outside = np.flatnonzero(~in_band)
    last = int(outside[-1]) + 1 if len(outside) else 0
    # Settled only if the last quarter of the step is inside the band.
    has_settling_time = band <= WIDEST_BAND and last < 0.75 * len(y)
    settling = last * T_s if has_settling_time else float("nan")
    # The effort counts from the final level: the current that holds the ball is no effort of the step.
    level = float(np.nanmean(u[part][-max(len(y) // 5, 1) :]))
    return [
        (_crossing(y, 0.9) - _crossing(y, 0.1)) * T_s,
        settling,
        float(np.nanmax(y)) - 1.0,
        float(np.nansum(np.abs(x_ref[part] - x[part]))) * T_s,
        float(np.nansum((u[part] - level) ** 2)) * T_s,
    ]


def settling_band(size_m: float, noise_m: float) -> float:
    """Return half the width of the settling band, a share of the step; `noise_m`: standard deviation of x, m."""
    return max(BAND, 4.0 * noise_m / abs(size_m))


def definition(
    name: str, bands: tuple[float, float] | None, figures: Mapping[str, tuple[str, str, float]] = FIGURES
) -> str:
    """Return the title of a figure for a table; `bands`: narrowest and widest of a settling time."""
    title = figures[name][0]
    if name != "settling_s":
        return title
    if bands is None:
        return f"{title} within ±{100 * BAND:.0f} %"
    low, high = (f"{100 * band:.2g}" for band in bands)
    return f"{title} within ±{low} %" if low == high else f"{title} within ±{low} to ±{high} %"


def _crossing(y: FloatArray, level: float) -> float:
    above = np.flatnonzero(y >= level)
    if not len(above):
        return float("nan")
    k = int(above[0])
    if k == 0 or not np.isfinite(y[k - 1]):
        return float(k)
    return k - 1 + float((level - y[k - 1]) / (y[k] - y[k - 1]))


def compared(name: str, rig: FloatArray, simulation: FloatArray, bands: Sequence[float] = ()) -> Compared:
    """Compare one figure of rig and simulation, each of shape (steps,); `bands`: settling band of each step."""
    both = np.isfinite(rig) & np.isfinite(simulation)
    n = int(both.sum())
    # Paired, not mean against mean: the steps differ in size and height, and that spread would hide a difference.
    difference = rig[both] - simulation[both]
    mean = float(difference.mean()) if n else float("nan")
    ci95, chance = None, float("nan")
    if n > 1:
        # Student, The probable error of a mean, 1908: of a few steps a normal interval would be too narrow.
        error = float(difference.std(ddof=1) / np.sqrt(n))
        half = student_quantile(0.975, n - 1) * error
        ci95 = (mean - half, mean + half)
        chance = 2.0 * student_above(abs(mean) / error, n - 1) if error > 0.0 else float(mean == 0.0)
    return Compared(
        name=name,
        rig=float(rig[both].mean()) if n else float("nan"),
        simulation=float(simulation[both].mean()) if n else float("nan"),
        difference=mean,
        ci95=ci95,
        chance=chance,
        count=n,
        steps=len(rig),
        rig_count=int(np.isfinite(rig).sum()),
        simulation_count=int(np.isfinite(simulation).sum()),
        bands=_widths(bands),
        too_small=sum(band > WIDEST_BAND for band in bands),
    )
