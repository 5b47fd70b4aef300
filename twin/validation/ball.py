"""The paper's figure 8, and multi-step prediction errors: the ball predicted from the filter's estimate by u_c alone.

The ball is unstable: an error grows by a factor of e in about 13 ms on a CE 152.  So open loop means short windows.

The noise floor is the error of a right model under the sensor noise alone (`twin/estimation/prediction_floor.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.distributions import Z_95
from twin.estimation.innovations import FLIES, FOLLOWS
from twin.estimation.prediction_floor import TOLERANCE, floor_rmse
from twin.estimation.record import BoolArray, FloatArray, runs
from twin.estimation.rollout import SETTLE_S, window
from twin.identification.horizon import HORIZONS_S
from twin.identification.horizon import errors as error_ahead
from twin.inference.theta import FLOORS
from twin.validation.amplifier import fit_percent
from twin.validation.source import Filtered

WINDOW_S = 0.04
FEWEST = 20.0  # independent errors: with fewer, any model would pass


@dataclass(frozen=True, slots=True, kw_only=True)
class Ahead:
    """Prediction error of x at one horizon."""

    horizon_s: float
    rmse_m: float
    floor_m: float
    ratio: float  # rmse / floor
    ratio_ci95: tuple[float, float]
    still_m: float  # rmse of the constant prediction "constant x"
    count: int
    at_floor: bool  # whether the interval of the ratio includes a right model
    beats_still: bool  # whether it is not significantly worse than "constant x"


@dataclass(frozen=True, slots=True, kw_only=True)
class Windows:
    """A stretch with short open-loop predictions, each from a new estimate; arrays of shape (n,)."""

    name: str
    t_s: FloatArray
    u_c_v: FloatArray
    measured_m: FloatArray
    simulated_m: FloatArray  # NaN between windows
    fit_percent: float  # over all windows of all recordings
    rmse_m: float
    count: int


def multi_step(runs_: Sequence[Filtered]) -> tuple[Ahead, ...]:
    """Return the errors over all flights, compared with the floor, by horizon; empty without predictions."""
    rows = []
    for nominal_s in HORIZONS_S:
        errors: list[FloatArray] = []
        constants: list[FloatArray] = []
        floor2, actual_s = 0.0, nominal_s
        for run in runs_:
            tick_s = run.source.record.interval_s
            ahead = max(round(nominal_s / tick_s), 1)
            actual_s = ahead * tick_s
            error, constant = error_ahead(run.system, run.series, run.state, ahead)
            good = np.isfinite(error)
            if good.any():
                errors.append(error)
                constants.append(constant[good])
                floor2 += int(good.sum()) * _floor_m(run, ahead, np.asarray(good)) ** 2
        count = sum(len(e) for e in constants)
        if not count:
            continue
        joined = np.concatenate(errors)
        mean2 = float(np.nanmean(joined**2))
        floor2 /= count
        # Relative standard error of a mean square of correlated Gaussian samples: sqrt(2 / n_eff).
        effective = _effective(joined, count)
        if effective < FEWEST:
            continue
        spread = np.sqrt(2.0 / effective)
        ratio = float(np.sqrt(mean2 / floor2))
        # The roots of mean2 / (1 +- z spread) over the floor; few errors would make the lower term negative.
        low = ratio / np.sqrt(1.0 + Z_95 * spread)
        high = ratio / np.sqrt(max(1.0 - Z_95 * spread, 0.05))
        unmoved = float(np.sqrt(np.mean(np.concatenate(constants) ** 2)))
        rows.append(
            Ahead(
                horizon_s=actual_s,
                rmse_m=float(np.sqrt(mean2)),
                floor_m=float(np.sqrt(floor2)),
                ratio=ratio,
                ratio_ci95=(float(low), float(high)),
                still_m=unmoved,
                count=count,
                at_floor=bool(low <= TOLERANCE),
                beats_still=bool(np.sqrt(mean2 / (1.0 + Z_95 * spread)) <= unmoved),
            )
        )
    return tuple(rows)


def _effective(error: FloatArray, count: int) -> float:
    """Return the effective number of independent errors: count over the sum of squared autocorrelations."""
    filled = np.where(np.isfinite(error), error, 0.0)
    power = float(filled @ filled)
    # The variance of a mean square of a Gaussian series is 2 / n times the sum of squared autocorrelations (M. S.
    # Bartlett, Supplement to the J. of the Royal Statistical Society 8, 1946).
    total = 1.0
    for lag in range(1, min(200, len(filled) - 1)):
        rho = float(filled[lag:] @ filled[:-lag]) / power
        total += 2.0 * rho * rho
    return max(count / total, 1.0)


def _floor_m(run: Filtered, ahead: int, predicted: BoolArray) -> float:
    # Process noise absorbs errors of the model: with it, a model without the rig's drag was below its own floor.
    noise = run.system.noise._replace(process_i_c_a=FLOORS["process_i_c_a"], process_a_m_s2=FLOORS["process_a_m_s2"])
    return floor_rmse(run.system._replace(noise=noise), run.series.samples, ahead, predicted)


def windows(runs_: Sequence[Filtered], *, window_s: float = 0.8) -> Windows | None:
    """Predict windows over all flights; the result has the stretch of `window_s` s with most motion for the figure.

    None if no flight is long enough.
    """
    best: tuple[float, Filtered, slice, FloatArray] | None = None
    errors, centred = [], []
    count = 0
    for run in runs_:
        tick_s = run.source.record.interval_s
        length, settle = max(round(WINDOW_S / tick_s), 2), max(round(SETTLE_S / tick_s), 2)
        s = run.series
        simulated = np.full(len(s), np.nan)
        for piece in _chains(run):
            # Windows, not the whole flight: the ball is unstable, so any model would be far off after a tenth of a
            # second.
            for begin in range(piece.start + settle, piece.stop - length, length):
                # The last sample stays NaN to separate the windows.
                simulated[begin : begin + length - 1] = window(run.system, s.samples, run.state, begin, length - 1)
                count += 1
            first = slice(piece.start + settle, min(piece.stop, piece.start + settle + round(window_s / tick_s)))
            for start in range(piece.start + settle, max(piece.stop - (first.stop - first.start), first.start + 1), 50):
                part = slice(start, start + first.stop - first.start)
                motion = float(np.std(s.x[part])) if part.stop - part.start > length else 0.0
                # The stretch with most motion, not the first: a ball at rest looks right under any model.
                if best is None or motion > best[0]:
                    best = (motion, run, part, simulated)
        good = np.isfinite(simulated) & np.isfinite(run.source.record.x)
        if good.any():
            errors.append(s.x[good] - simulated[good])
            centred.append(s.x[good] - s.x[good].mean())
    if best is None or not errors:
        return None
    error = np.concatenate(errors)
    _, run, part, simulated = best
    return Windows(
        name=run.source.record.name,
        t_s=np.cumsum(run.series.step[part]) - run.series.step[part][0],
        u_c_v=run.series.u[part],
        measured_m=run.source.record.x[part],
        simulated_m=simulated[part],
        fit_percent=fit_percent(error, np.concatenate(centred)),
        rmse_m=float(np.sqrt(np.mean(error**2))),
        count=count,
    )


def _chains(run: Filtered) -> list[slice]:
    free: BoolArray = np.asarray((run.series.flags & (FLIES | FOLLOWS)) == (FLIES | FOLLOWS))
    return runs(free, max(round((SETTLE_S + 2 * WINDOW_S) / run.source.record.interval_s), 8))
