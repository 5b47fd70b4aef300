"""The amplifier by the paper's graphical method: K_A from steady levels, T_A and order from step responses.

Rule 1: K_A is the slope of the line through (u_c, median of i_c) of all levels.  The offset is estimated and reported:
        otherwise an offset of 20 mA of the current sensor would change K_A by 2 %.
Rule 2: a step response is first order if the residual of the best first-order response is explained by the noise of the
        levels.  K_A does not depend on that, because it uses steady levels only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.distributions import Z_95, robust_spread, student_quantile
from twin.estimation.record import FloatArray, Record, intervals, runs
from twin.settings import identification as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A steady level."""

    u_v: float
    i_a: float
    error_a: float  # standard error of the median


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """The line through all levels."""

    K_A: float
    K_A_std: float
    offset_a: float
    offset_std_a: float
    levels: tuple[Level, ...]
    bend_a: float = 0.0  # largest distance of a level from the line; 0 if it is not significant
    bend_at_v: float = 0.0  # u_c of that level


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """First-order responses fitted to all steps."""

    T_A: float
    T_A_std: float
    steps: int
    residual_a: float  # rms, in the transients
    resolution_a: float  # converter step of i_c if the noise is below it; otherwise 0
    ratio: float  # rms residual in the transients over the noise, or over the resolution
    z: float  # of the chi-square test of the residuals
    spread: float  # of T_A from step to step, relative
    first_order: bool
    sample_time_s: float

    @property
    def text(self) -> str:
        """The residual, and its ratio to the noise or the resolution, for a message."""
        other = "the resolution" if self.resolution_a else "the noise"
        many = f"{self.ratio:.1f} times" if self.ratio < settings.MAX_RATIO else "far beyond"
        return f"{self.residual_a * 1e3:.3g} mA rms, {many} {other}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    sample_time_s: float
    i: FloatArray  # i[0] is the last sample before the step acts


def find_levels(records: list[Record]) -> Levels | None:
    """The line through the levels of amplifier steps and captures, or without these, of all open-loop recordings.

    None with fewer than two different levels.
    """
    chosen = [r for r in records if r.kind == "amplifier-step" or r.captures]
    levels = [level for record in chosen for level in _plateaus(record)]
    if len({round(level.u_v, 6) for level in levels}) < 2:
        excited = [r for r in records if r.kind in ("prbs", "free", "sawtooth") and r.has("u_c", "i_c")]
        levels += [level for record in excited for level in _plateaus(record)]
    if len({round(level.u_v, 6) for level in levels}) < 2:
        return None
    u = np.array([level.u_v for level in levels])
    i = np.array([level.i_a for level in levels])
    error = np.maximum([level.error_a for level in levels], 1e-9)
    distinct = len(set(np.round(u, 6)))
    columns = np.column_stack((u, np.ones(len(u))))
    weight = 1.0 / error
    solution = np.zeros(2)
    extra = 0.0
    for _ in range(30):  # Huber weights: a level in the dead zone or at a limit must not tilt the line
        total = np.sqrt(error**2 + extra**2)
        row = columns / total[:, None]
        scaled = weight * error
        solution = np.linalg.lstsq(row * scaled[:, None], i / total * scaled, rcond=None)[0]
        residual = i - columns @ solution
        extra = robust_spread(residual) if distinct > 2 else 0.0
        ratio = np.abs(residual) / np.maximum(np.sqrt(error**2 + extra**2), 1e-12)
        weight = (
            np.where(ratio > settings.HUBER_ERRORS, np.sqrt(settings.HUBER_ERRORS / np.maximum(ratio, 1e-12)), 1.0)
            / error
        )
    total = np.sqrt(error**2 + extra**2) / np.maximum(weight * error, 1e-6)
    covariance = np.linalg.inv((columns / total[:, None] ** 2).T @ columns)
    # With few levels their scatter is uncertain: Student's factor.
    widen = student_quantile(0.975, max(len(u) - 2, 1)) / Z_95 if distinct > 2 else 1.0
    bend, at, systematic = _bend(u, i - columns @ solution, error)
    return Levels(
        K_A=float(solution[0]),
        K_A_std=float(np.hypot(np.sqrt(covariance[0, 0]) * min(widen, 6.5), systematic)),
        offset_a=float(solution[1]),
        offset_std_a=float(np.sqrt(covariance[1, 1])) * min(widen, 6.5),
        levels=tuple(levels),
        bend_a=bend,
        bend_at_v=at,
    )


def _bend(u: FloatArray, residual: FloatArray, error: FloatArray) -> tuple[float, float, float]:
    """Return (residual of the level furthest from the line, its u_c, standard error of the slope due to the bend).

    All are 0 if the levels lie on a line within their errors.  A limit, a dead zone or a coil that heats bends the
    line.  Levels of the same u_c then have the same error, so their number does not reduce the error of the slope.
    """
    same = np.round(u / max(settings.SAME_LEVEL * float(np.ptp(u)), 1e-12)).astype(int)
    values = np.unique(same)
    if len(values) < 3:
        return 0.0, 0.0, 0.0
    groups = [same == value for value in values]
    mean = np.array([residual[g].mean() for g in groups])
    mean_std = [
        max(float(np.sqrt(np.mean(error[g] ** 2))), float(residual[g].std()) if g.sum() > 2 else 0.0)
        / float(np.sqrt(g.sum()))
        for g in groups
    ]
    z = np.abs(mean) / np.maximum(mean_std, 1e-12)
    if float(np.max(z)) < settings.LINE_ERRORS:
        return 0.0, 0.0, 0.0
    k = int(np.argmax(np.abs(mean)))
    at = np.array([float(u[g].mean()) for g in groups])
    slope_error = float(np.sqrt(np.sum(mean**2) / (len(mean) - 2) / np.sum((at - at.mean()) ** 2)))
    return float(mean[k]), float(at[k]), slope_error * (student_quantile(0.975, len(mean) - 2) / Z_95)


def _plateaus(record: Record) -> list[Level]:
    stretches: list[tuple[float, FloatArray]] = []
    for capture in record.captures:
        before, after = capture.i_c_a[: capture.step_index], capture.i_c_a[capture.step_index + 1 :]
        stretches += [(capture.u_from_v, before), (capture.u_to_v, after[len(after) // 2 :])]
    constant = record.kind == "prbs" or (record.kind not in ("equilibria", "closed-loop") and not record.captures)
    for piece in _constant_pieces(record) if constant and record.has("u_c", "i_c") else ():
        half = (piece.stop - piece.start) // 2
        stretches.append((float(np.median(record.u_c[piece])), record.i_c[piece][half:]))
    return [level for u, i in stretches if (level := _level(u, i)) is not None]


def _constant_pieces(record: Record) -> list[slice]:
    _, follows = intervals(record.t)
    span = float(np.nanmax(record.u_c) - np.nanmin(record.u_c))
    is_constant = np.zeros(len(record.t), np.bool_)
    is_constant[1:] = (np.abs(np.diff(record.u_c)) <= settings.SAME_LEVEL * span) & follows[1:]
    # A slow ramp changes little from sample to sample, so the change over the whole level is tested, too.
    return [
        piece
        for piece in runs(is_constant, settings.LEVEL_SAMPLES)
        if float(np.ptp(record.u_c[piece])) <= 2.0 * settings.SAME_LEVEL * max(span, 1e-12) or span == 0.0
    ]


def _level(u: float, i: FloatArray) -> Level | None:
    """The median of a settled stretch; None if it still changes."""
    i = i[np.isfinite(i)]
    n = len(i)
    if n < settings.LEVEL_SAMPLES // 2:
        return None
    first, last = i[: n // 2], i[n // 2 :]
    noise = max(robust_spread(i - np.median(i)), float(np.std(np.diff(i))) / np.sqrt(2.0))
    # sqrt(pi / 2), by which a median of normal noise scatters more than a mean.  A mean would follow a jump at the end
    # of a level.
    error = 1.2533 * noise / np.sqrt(n)
    drift = abs(float(np.mean(last) - np.mean(first)))
    if drift > 4.0 * 2.0 * noise / np.sqrt(n) and drift > 0.01 * max(abs(float(np.median(i))), 1e-12):
        return None
    return Level(u_v=u, i_a=float(np.median(i)), error_a=max(error, drift / 2.0))


def find_shape(records: list[Record]) -> Shape | None:
    """Return the first-order fit to all steps, of captures if there are any; None without a usable step."""
    from scipy.optimize import minimize_scalar  # here: it takes 18 MB, and the running twin fits no step

    steps = [step for record in records for step in _captured_steps(record)]
    if not steps:
        steps = [step for record in records if record.kind == "amplifier-step" for step in _recorded_steps(record)]
    if not steps:
        return None
    noise = np.array([float(np.std(np.diff(step.i[-max(len(step.i) // 4, 8) :]))) for step in steps])  # at its end
    sigma = float(np.sqrt(np.mean((noise / float(np.sqrt(2.0))) ** 2)))
    resolution = max(_resolution(step.i) for step in steps)
    unresolved = sigma < resolution / np.sqrt(12.0)
    sigma = max(sigma, resolution / np.sqrt(12.0))
    shortest, longest = steps[0].sample_time_s / 30.0, len(steps[0].i) * steps[0].sample_time_s

    def cost(log_tau: float) -> float:
        return sum(_first_order(step, float(np.exp(log_tau)))[0] for step in steps)

    # A grid before the search: the cost of a T_A is flat far above and far below the right one.
    grid = np.linspace(np.log(shortest), np.log(longest), 60)
    values = [cost(g) for g in grid]
    k = int(np.argmin(values))
    bounds = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    best = float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-7}).x)
    curvature = (cost(best + 0.02) - 2.0 * cost(best) + cost(best - 0.02)) / 0.02**2
    T_A = float(np.exp(best))
    single = []
    squares, count = 0.0, 0
    for step in steps:
        residual = _first_order(step, T_A)[1]
        last = min(max(int(np.ceil(6.0 * T_A / step.sample_time_s)), 4), len(residual))
        squares += float(np.sum(residual[1:last] ** 2))
        count += last - 1
        # Each step alone, too: a T_A that changes from step to step is no constant of (1), however well the mean fits.
        single_fit = minimize_scalar(
            lambda g, step=step: _first_order(step, float(np.exp(g)))[0],
            bounds=(best - 2.0, best + 2.0),
            method="bounded",
        )
        single.append(float(np.exp(single_fit.x)))
    chi2 = squares / sigma**2
    ratio = float(np.sqrt(chi2 / max(count, 1)))
    # The uncertainty of the estimated noise level adds to that of the chi-square.
    z = (chi2 - count) / np.sqrt(2.0 * count + 2.0 * count**2 / max(sum(len(s.i) // 4 for s in steps), 1))
    return Shape(
        T_A=T_A,
        T_A_std=float(T_A * sigma * np.sqrt(2.0 / max(curvature, 1e-300))),
        steps=len(steps),
        residual_a=float(np.sqrt(squares / max(count, 1))),
        resolution_a=resolution if unresolved else 0.0,
        ratio=ratio,
        z=float(z),
        spread=float(np.std(single) / T_A) if len(single) > 1 else 0.0,
        first_order=not (z > settings.SHAPE_ERRORS and ratio > settings.SHAPE_RATIO),
        sample_time_s=steps[0].sample_time_s,
    )


def _captured_steps(record: Record) -> list[_Step]:
    return [
        _Step(sample_time_s=c.sample_time_s, i=c.i_c_a[c.step_index :])
        for c in record.captures
        if c.u_from_v != c.u_to_v and len(c.i_c_a) - c.step_index >= 20
    ]


def _recorded_steps(record: Record) -> list[_Step]:
    if not record.has("u_c", "i_c"):
        return []
    steps = []
    for piece in _constant_pieces(record):
        start = piece.start - 1  # this sample has the new u_c but still the old i_c
        jump = abs(float(record.u_c[start] - record.u_c[start - 1])) if start > 0 else 0.0
        i = record.i_c[start : piece.stop]
        if (
            jump > 10.0 * settings.SAME_LEVEL * float(np.nanmax(np.abs(record.u_c)))
            and len(i) >= 20
            and np.isfinite(i).all()
        ):
            steps.append(_Step(sample_time_s=record.interval_s, i=i))
    return steps


def _resolution(i: FloatArray) -> float:
    """The smallest step of a quantised or rounded channel, at least RESOLUTION of its range."""
    values = np.unique(i)
    span = float(np.ptp(values))
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * span]  # smaller gaps are rounding errors
    return max(float(gaps.min()) if gaps.size else 0.0, settings.RESOLUTION * span, 1e-9)


def _first_order(step: _Step, T_A: float) -> tuple[float, FloatArray]:
    """Return (sum of squares, residual) of i = c + a exp(-t/T_A) with both free."""
    # (1) with level and jump free, by linear least squares: so neither K_A nor an offset enters T_A.
    decay = np.exp(-np.arange(len(step.i)) * step.sample_time_s / T_A)
    columns = np.column_stack((np.ones(len(step.i)), decay))
    solution, *_ = np.linalg.lstsq(columns, step.i, rcond=None)
    residual = step.i - columns @ solution
    return float(residual @ residual), residual
