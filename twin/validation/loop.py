"""The paper's figures 11 and 12: the closed loop measured, and simulated with the identified noise.

Rule 1: the simulation uses the recorded reference, and the rig's state and integral at its first sample only.
Rule 2: a law that does not reproduce the recorded u_c from the recorded samples was not in use: the closed loop is not
        testable then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.control import LawNumbers, integral_behind, law, rounded
from twin.estimation.record import FloatArray, Record, runs
from twin.estimation.rollout import SETTLE_S
from twin.estimation.step_figures import LoopRun
from twin.evidence.checks.control_law import law_gap
from twin.mirror.loop import run_law
from twin.mirror.monitor.expected import autocovariance, error_dynamics
from twin.model.extended import I_C, Base, V, X
from twin.model.parameters import Model
from twin.model.simulate import I_READ, INTEGRAL, X_BEFORE, X_READ, PlantNumbers, hold, plant_numbers, rig_at
from twin.settings.mirror import STABLE
from twin.validation.source import Filtered, Source

SHORTEST_S = 0.5
UNEXPLAINED = 0.25  # largest share of the changes of u_c that rounding may leave unexplained
REALISATIONS = 8


@kernel
def simulate_loop(
    plant: Packed,
    numbers: Packed,
    x_ref: NDArray[np.float64],
    noise: NDArray[np.float64],
    lsb: NDArray[np.float64],
    begin: NDArray[np.float64],
    before: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Fill out, shape (3, n), with the board's readings of i_c and x, and u_c.

    Args:
        plant: tuple(PlantNumbers).
        numbers: tuple(LawNumbers).
        x_ref: m, shape (n,).
        noise: of the readings of i_c (A) and x (m), process noise of i_c (A) and x' (m/s), shape (4, n).
        lsb: one count of i_c (A), x (m), u_c (V), shape (3,); 0: no rounding.
        begin: initial memory of the simulated rig and its law (`twin/model/simulate.py`).
        before: inputs sent before the first sample and not yet acting, V, oldest first; their number is the delay.
        out: receives the result.
    """
    memory = begin.copy()
    travel = Base(*PlantNumbers(*plant).base).travel_m
    delay = len(before)
    for k in range(len(x_ref)):
        i_m, x_m = rounded(memory[I_READ] + noise[0, k], lsb[0]), rounded(memory[X_READ] + noise[1, k], lsb[1])
        u = rounded(run_law(numbers, memory, i_m, x_m, x_ref[k]), lsb[2])
        out[0, k], out[1, k], out[2, k] = i_m, x_m, u
        acting = u
        if delay > 0:
            acting = before[k] if k < delay else out[2, k - delay]
        hold(plant, memory, acting)
        memory[I_C] += noise[2, k]
        # A ball at a stop gets none: noise alone would make it bounce.
        if 0.0 < memory[X] < travel:
            memory[V] += noise[3, k]


def closed_loops(runs_: Sequence[Filtered], model: Model) -> tuple[list[LoopRun], list[str]]:
    """Return (all flights that can be simulated, sentences on why the others cannot)."""
    flights: list[LoopRun] = []
    why: dict[str, list[str]] = {}
    for seed, run in enumerate(runs_, 1):
        loops, reason = _flights(run, model, seed=seed)
        flights += loops
        if reason:
            why.setdefault(reason, []).append(run.source.record.name)
    return flights, [f"{reason} ({', '.join(names)})" for reason, names in why.items()]


def _flights(run: Filtered, model: Model, *, seed: int) -> tuple[list[LoopRun], str]:
    """Return (the simulated flights of one recording, why some or all are left out)."""
    record, c = run.source.record, run.source.law
    if c is None:
        return [], run.source.without_law
    if not record.has("x_ref"):
        return [], "no reference was recorded"
    if abs(record.interval_s - c.sample_time_s) > 0.05 * c.sample_time_s:
        return [], (
            f"sampled every {record.interval_s * 1e3:.3g} ms, the law runs every {c.sample_time_s * 1e3:.3g} ms"
        )
    gap = law_gap(record, model.plant, c)
    if gap is not None and gap.contradicted:
        return [], (
            f"the law does not give the recorded u_c ({100 * gap.share:.0f} % of its movement is unexplained): "
            f"{gap.text()}"
        )
    flown = _flown(run, c)
    if not flown:
        return [], f"no flight of {SHORTEST_S:g} s with a steady sampling time and a known reference"
    simulated, reason = [], ""
    for piece in flown:
        begin = _begin(run, c, piece)
        if begin is None:
            reason = "u_c stays at its limit, so the law's integral is not known"
            continue
        start, integral = begin
        part = slice(start, piece.stop)
        left = unexplained(run.source, c, part, integral)
        if left > UNEXPLAINED:
            reason = (
                f"the law does not give the recorded u_c ({100 * left:.0f} % of its changes is unexplained): "
                "other gains, another filter or another operating point was in use"
            )
            continue
        # Each flight of a recording has the same seed: its noise does not depend on which others are left out.
        simulated.append(_simulate(run, model, c, part, integral, seed=seed))
    return simulated, reason


def measured_loops(run: Filtered) -> list[LoopRun]:
    """The flights of a recording without a simulation, if the law is not known; longest first."""
    r = run.source.record
    if not r.has("x_ref"):
        return []
    free = np.isfinite(run.state[:, 0]) & np.isfinite(r.x_ref) & np.isfinite(r.u_c)
    pieces = runs(np.asarray(free), max(round(SHORTEST_S / r.interval_s), 2))
    loops = [_loop(r, piece, np.full((2, 3, piece.stop - piece.start), np.nan), math.nan) for piece in pieces]
    return sorted(loops, key=lambda loop: -len(loop.t_s))


def _loop(record: Record, piece: slice, simulated: FloatArray, expected_std_m: float) -> LoopRun:
    """Put a flight together; `simulated`: i_c, x, u_c of each realisation, the last without noise, shape (m, 3, n)."""
    return LoopRun(
        name=record.name,
        t_s=record.t[piece] - record.t[piece.start],
        x_ref_m=record.x_ref[piece],
        x_m=record.x[piece],
        i_c_a=record.i_c[piece],
        u_c_v=record.u_c[piece],
        simulated_x_m=simulated[:-1, 1],
        simulated_i_c_a=simulated[:-1, 0],
        simulated_u_c_v=simulated[:-1, 2],
        quiet_x_m=simulated[-1, 1],
        expected_std_m=expected_std_m,
    )


def unexplained(source: Source, c: LawNumbers, part: slice, integral: float) -> float:
    """Return the part of the changes of u_c that the law does not explain (ratio of 90 % quantiles).

    Args:
        source: the recording.
        c: the law.
        part: samples of it; the one before the first must exist.
        integral: of the law at the first sample, m s.
    """
    r = source.record
    s, x_prev = integral, float(r.x[part.start - 1])
    predicted = np.full(part.stop - part.start, np.nan)
    for n, k in enumerate(range(part.start, part.stop)):
        i, x = float(r.i_c[k]), float(r.x[k])
        if not (np.isfinite(i) and np.isfinite(x)):
            continue
        predicted[n], s = law(c, i, x, x_prev, s, float(r.x_ref[k]))
        x_prev = x
    measured = r.u_c[part]
    left, moves = np.diff(measured - predicted), np.diff(measured)
    known = np.isfinite(left) & np.isfinite(moves)
    if not known.any():
        return float("inf")
    # A quantile and not the rms, because of outliers.
    size = float(np.quantile(np.abs(moves[known]), 0.9))
    return float(np.quantile(np.abs(left[known]), 0.9)) / size if size > 0.0 else 0.0


def _flown(run: Filtered, c: LawNumbers) -> list[slice]:
    record = run.source.record
    # The simulation runs one tick for each sample, so the steps must be ticks.
    steady = np.abs(run.series.step - c.sample_time_s) < 0.05 * c.sample_time_s
    free = steady & np.isfinite(run.state[:, 0]) & np.isfinite(record.x_ref) & np.isfinite(record.u_c)
    return runs(np.asarray(free), round((SHORTEST_S + SETTLE_S) / c.sample_time_s))


def _begin(run: Filtered, c: LawNumbers, piece: slice) -> tuple[int, float] | None:
    """Return (sample, integral) of the first sample after settling at which u_c determines the law's integral."""
    r = run.source.record
    settle = round(SETTLE_S / c.sample_time_s)
    for k in range(piece.start + settle, piece.stop - round(SHORTEST_S / c.sample_time_s) + settle):
        values = [float(v) for v in (r.i_c[k], r.x[k], r.x[k - 1], r.x_ref[k], r.u_c[k])]
        if np.all(np.isfinite(values)):
            i, x, x_prev, x_ref, u = values
            integral = integral_behind(c, i=i, x=x, x_prev=x_prev, x_ref=x_ref, u=u)
            if integral is not None:
                return k, integral
    return None


def _simulate(run: Filtered, model: Model, c: LawNumbers, part: slice, integral: float, *, seed: int) -> LoopRun:
    r, n = run.source.record, part.stop - part.start
    rng = np.random.default_rng(seed)
    plant = plant_numbers(model, c.sample_time_s)
    noise_levels = np.array(
        [
            model.noise.sigma_i_c_a,
            model.noise.sigma_x_m,
            model.noise.process_i_c_a,
            model.noise.process_a_m_s2 * c.sample_time_s,
        ]
    )
    lsb = np.array([*r.lsb, run.source.u_lsb_v])
    i, x, v = run.readings[part.start].tolist()
    begin = rig_at(plant, i=i, x=x, v=v, u=float(r.u_c[part.start - 1]))
    begin[INTEGRAL], begin[X_BEFORE] = integral, r.x[part.start - 1]
    delay = run.source.delay
    before = np.asarray(r.u_c[part.start - delay : part.start], dtype=float)
    # Contiguous: for a strided array the kernel would be compiled once more.
    x_ref = np.ascontiguousarray(r.x_ref[part])
    out = np.empty((REALISATIONS + 1, 3, n))
    for m in range(REALISATIONS + 1):
        scale = 0.0 if m == REALISATIONS else 1.0
        noise = scale * noise_levels[:, None] * rng.standard_normal((4, n))
        simulate_loop(tuple(plant), tuple(c), x_ref, noise, scale * lsb, begin, before, out[m])
    # At the mean reference, and below the coil, where (14) is singular.
    loop = error_dynamics(model, c, float(np.clip(np.mean(x_ref), 0.0, 0.95 * model.plant.travel_m)))
    expected = float("nan")
    if np.max(np.abs(np.linalg.eigvals(loop[0]))) < STABLE:
        variances = noise_levels**2
        variances[:2] += lsb[:2] ** 2 / 12.0
        ordered = np.array([variances[0], variances[1], lsb[2] ** 2 / 12.0, variances[2], variances[3]])
        expected = float(np.sqrt(autocovariance(*loop, ordered, lags=1)[0, 0]))
    return _loop(r, part, out, expected)
