"""Four parameters from 20 s at 500 Hz: `board51 identify`'s estimator against what one writes first.

Baseline: the closed loop simulated tick by tick with scipy's `solve_ivp`, fitted to the recorded x and i_c with scipy's
`least_squares`.  Its cost is timed on the full record (best of three); its fit is run to the end on a shorter one,
because on the full record it takes minutes; the time of the full fit is (evaluations that the short fit needed) x (time
of one on the full record).  Ours is the whole estimate after compilation: start values and noise levels included,
checks and intervals not.
"""

from __future__ import annotations

import math
import time
from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from tests.harness.twin.independent_plant import Ball, wandering
from twin.estimation.prepare import prepare
from twin.estimation.record import Record
from twin.identification.fit import Blocks, bare, fit
from twin.identification.pipeline import identify_records
from twin.identification.starts import find_starts
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import Fit
from twin.inference.theta import BASE

FloatArray = NDArray[np.float64]
TICKS = 10_000  # 20 s
SHORT_TICKS = 500  # 1 s: on what the baseline's fit is run to the end
BALL = Ball()
_NAMES = ("K_A", "T_A", "K_c", "b")


def run() -> list[dict[str, Any]]:
    """The rows of the benchmark."""
    record = BALL.closed_loop(wandering(1, TICKS), TICKS, seed=2)
    estimate, estimate_s = _timed_estimate(record)
    evaluations, fitted, short_s = _baseline_fit(_head(record, SHORT_TICKS))
    full_s = min(_time_cost(record) for _ in range(3))
    baseline_s = evaluations * full_s
    short_estimate, _ = _timed_estimate(_head(record, SHORT_TICKS))
    rows: list[dict[str, Any]] = [
        {
            "name": "identify: four parameters, 20 s at 500 Hz",
            "value": estimate_s,
            "unit": "s",
            "baseline": baseline_s,
            "ratio": baseline_s / estimate_s,
            "note": f"baseline: {evaluations} cost evaluations of a fit on {SHORT_TICKS * BALL.tick:g} s "
            f"(measured {short_s:.1f} s) x {full_s:.2f} s for one on 20 s",
        }
    ]
    for n, name in enumerate(_NAMES):
        true = getattr(BALL, name)
        rows.append(
            {
                "name": f"identify: relative error of {name} on the same 1 s",
                "value": abs(getattr(short_estimate.theta, name) / true - 1.0),
                "unit": "1",
                "baseline": abs(float(fitted[n]) / true - 1.0),
                "ratio": abs(float(fitted[n]) / true - 1.0)
                / max(abs(getattr(short_estimate.theta, name) / true - 1.0), 1e-12),
                "note": f"on 20 s ours is off by {abs(getattr(estimate.theta, name) / true - 1.0):.1e}",
            }
        )
    whole, whole_s, count = _campaign()
    rows.append(
        {
            "name": "identify: whole campaign, 90 s of data",
            "value": whole_s,
            "unit": "s",
            "baseline": 10.0,
            "ratio": 10.0 / whole_s,
            "note": f"{count} samples, checks, fits, intervals; baseline is the limit asked for; usable: {whole}",
        }
    )
    return rows


def _head(record: Record, ticks: int) -> Record:
    return Record(
        name=record.name,
        kind=record.kind,
        use=record.use,
        t=record.t[:ticks],
        u_c=record.u_c[:ticks],
        i_c=record.i_c[:ticks],
        x=record.x[:ticks],
        x_ref=record.x_ref[:ticks],
    )


def _estimate(record: Record) -> Fit:
    plant = BALL.campaign.plant
    starts = find_starts([record], plant)
    assert starts.amplifier is not None
    series, _ = prepare([record], plant)
    with closing(Criterion(bare(series), plant, BALL.tick)) as criterion:
        return fit(Blocks(criterion), starts.theta(starts.amplifier, plant.mass_kg), BASE)


def _timed_estimate(record: Record) -> tuple[Fit, float]:
    _estimate(_head(record, 500))  # compiles, or loads the compiled kernels
    best = math.inf
    for _ in range(3):
        began = time.perf_counter()
        estimate = _estimate(record)
        best = min(best, time.perf_counter() - began)
    return estimate, best


def _campaign() -> tuple[bool, float, int]:
    records = [BALL.closed_loop(wandering(n, 15_000), 15_000, seed=n, name=f"flight {n}") for n in range(3)]
    began = time.perf_counter()
    identification = identify_records(BALL.campaign, records)
    return identification.usable, time.perf_counter() - began, sum(len(r.t) for r in records)


def _simulate(theta: FloatArray, record: Record) -> FloatArray:
    """x and i_c of the closed loop by the model, one solve_ivp a tick."""
    K_A, T_A, K_c, b = theta
    m, g, x_max, tick = BALL.m, BALL.g, BALL.x_max, BALL.tick
    x_0 = 0.5 * BALL.travel
    i_0 = BALL.current(x_0)
    y = np.array([i_0, x_0, 0.0])
    s, x_before = 0.0, x_0
    out = np.empty((len(record.t), 2))

    def rates(_: float, y: FloatArray, u: float) -> list[float]:
        i, x, v = y
        return [(K_A * u - i) / T_A, v, (K_c * i * i / (x_max - x) ** 2 - b * v) / m - g]

    for k in range(len(record.t)):
        out[k] = y[1], y[0]
        u = i_0 / BALL.K_A - (
            0.49 * (y[0] - i_0) + 2000.0 * (y[1] - x_0) + 18.0 * (y[1] - x_before) / tick - 17600.0 * s
        )
        u = min(max(u, 0.0), 5.0)
        s += (record.x_ref[k] - y[1]) * tick
        x_before = y[1]
        y = solve_ivp(rates, (0.0, tick), y, args=(u,), rtol=1e-6, atol=1e-9).y[:, -1]
        y[1] = min(max(y[1], 0.0), BALL.travel)
    return out


def _residual(log_theta: FloatArray, record: Record) -> FloatArray:
    out = _simulate(np.exp(log_theta), record)
    return np.concatenate(((out[:, 0] - record.x) / BALL.sigma_x, (out[:, 1] - record.i_c) / BALL.sigma_i))


def _time_cost(record: Record) -> float:
    began = time.perf_counter()
    _simulate(np.array([BALL.K_A, BALL.T_A, BALL.K_c, BALL.b]), record)
    return time.perf_counter() - began


def _baseline_fit(record: Record) -> tuple[int, FloatArray, float]:
    start = np.log([1.03 * BALL.K_A, 1.3 * BALL.T_A, 1.03 * BALL.K_c, 1.5 * BALL.b])
    count = 0

    def residual(theta: FloatArray) -> FloatArray:
        nonlocal count
        count += 1
        return _residual(theta, record)

    began = time.perf_counter()
    solution = least_squares(residual, start, x_scale=0.1)
    return count, np.exp(solution.x), time.perf_counter() - began


if __name__ == "__main__":
    for row in run():
        print(row)
