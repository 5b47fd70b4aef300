"""Starting values without an initial guess: the amplifier by simulation over a grid, the ball by linear regression.

The amplifier (1) is stable and independent of the ball.  For each T_A of a grid its response to the recorded u_c is
simulated and K_A is found by linear regression; the pair with the smallest residual is used.

The ball (6) is unstable.  It becomes linear in k = K_c/m and d = b/m by modulating functions (Shinbrot, 1957).  It is
multiplied by a smooth window phi that vanishes with its slope at both ends, and integrated by parts:

    integral of phi'' x + g phi  =  k integral of phi i^2/(x_max - x)^2  +  d integral of phi' x

This needs no derivative of a noisy signal and no initial state, and has no local minimum.  A window is about 60 ms.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from protocol.campaign import Plant
from twin.estimation.low_pass import low_pass
from twin.estimation.prepare import flights
from twin.estimation.record import FloatArray, Record, intervals, runs
from twin.settings import identification as settings

_CONVOLVED = 50_000  # samples at a time: limits the memory
OVERLAP = 4  # windows begin a quarter of their length apart


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplifierStart:
    """K_A, T_A and the noise of i_c."""

    K_A: float
    T_A: float
    sigma_i_c_a: float
    share: float  # of the variance of i_c that u_c explains


@dataclass(frozen=True, slots=True, kw_only=True)
class BallStart:
    """k = K_c / m and d = b / m of the regression, with its quality."""

    k: float
    d: float
    misfit: float  # rms of the residual over rms of the left side without its mean
    windows: int
    d_std: float = float("nan")  # of d, neighbouring windows taken as dependent


def amplifier_start(records: list[Record]) -> AmplifierStart | None:
    """The pair K_A, T_A that best explains i_c by u_c over all recordings and captures; None without data."""
    pieces: list[tuple[float, FloatArray, FloatArray]] = []
    for record in records:
        for capture in record.captures:
            u = np.full(len(capture.i_c_a), capture.u_to_v)
            u[: capture.step_index] = capture.u_from_v
            pieces.append((capture.sample_time_s, u, capture.i_c_a))
        if record.kind == "equilibria" or not record.has("u_c", "i_c"):
            continue
        _, follows = intervals(record.t)
        for run in runs(np.isfinite(record.u_c) & np.isfinite(record.i_c), 20):
            starts = np.flatnonzero(~follows[run])
            edges = [run.start, *(run.start + int(n) for n in starts if n > 0), run.stop]
            for a, b in pairwise(edges):
                if b - a >= 20:
                    b = min(b, a + settings.START_SAMPLES)
                    pieces.append((record.interval_s, record.u_c[a:b], record.i_c[a:b]))
    pieces = [piece for piece in pieces if np.ptp(piece[1]) > 0.0]
    if not pieces:
        return None
    fastest = min(piece[0] for piece in pieces)
    slowest = max(piece[0] for piece in pieces)
    grid = np.geomspace(settings.SHORTEST_T_A * fastest, settings.LONGEST_T_A * slowest, 40).tolist()
    (K_A, square), T_A = min(((_simulate(pieces, T_A), T_A) for T_A in grid), key=lambda fit: fit[0][1])
    count = sum(len(piece[1]) for piece in pieces)
    spread = sum(float(np.sum((piece[2] - np.mean(piece[2])) ** 2)) for piece in pieces)
    return AmplifierStart(
        K_A=K_A,
        T_A=T_A,
        sigma_i_c_a=float(np.sqrt(max(square / count, 1e-12))),
        share=1.0 - square / spread if spread > 0 else 0.0,
    )


def _simulate(pieces: list[tuple[float, FloatArray, FloatArray]], T_A: float) -> tuple[float, float]:
    """Return (K_A, sum of squares) of the regression of i_c on the filtered u_c and the decay of the first current."""
    cross = power = 0.0
    prepared = []
    for step, u, i in pieces:
        # (1) exactly over an interval under a held u_c: an Euler step would be wrong for T_A below it.
        a = float(np.exp(-step / T_A))
        response = low_pass(u, a)
        alive = min(len(i), int(30.0 * T_A / step) + 1)  # later powers are denormal numbers, a hundred times slower
        free = i.copy()
        free[:alive] -= i[0] * np.exp(-np.arange(alive) * (step / T_A))
        # Within an interval the first sample is not predicted; it is the initial state.
        prepared.append((response[1:], free[1:]))
        cross += float(response[1:] @ free[1:])
        power += float(response[1:] @ response[1:])
    K_A = cross / power if power > 0 else 0.0
    return K_A, sum(float(np.sum((free - K_A * response) ** 2)) for response, free in prepared)


def ball_start(
    records: list[Record], plant: Plant, amplifier: AmplifierStart | None, *, downwards: bool = False
) -> BallStart | None:
    """Fit the regression over all windows of all flights; None if no flight is as long as a window.

    Without `amplifier` the current between samples is linear.  `downwards` treats x as measured down from the upper
    stop, as a test for that mistake.
    """
    for window_s in (settings.WINDOW_S, 0.5 * settings.WINDOW_S):
        rows = force_rows(records, plant, amplifier, window_s, downwards=downwards)
        if sum(len(row) for row in rows) >= settings.WINDOWS:
            break
    if not rows:
        return None
    return _regress(np.concatenate(rows))


def force_rows(
    records: list[Record], plant: Plant, amplifier: AmplifierStart | None, window_s: float, *, downwards: bool = False
) -> list[FloatArray]:
    """The integrals of the regression, an array of shape (n, 3) for each flight: left side, force / k, drag / d.

    Arguments as in `ball_start`; `window_s`: length of a window, s.
    """
    rows: list[FloatArray] = []
    for record in records:
        if record.kind in ("equilibria", "sawtooth", "amplifier-step") or not record.has("i_c", "x"):
            continue
        step = record.interval_s
        width = max(round(window_s / step), 8)
        whole = flights(record, plant, min_samples=width + 1)
        for flight in (part for long in whole for part in _cut(long, width)):
            x = record.x[flight]
            i = record.i_c[flight]
            u = record.u_c[flight]
            good = np.isfinite(x) & np.isfinite(i)
            if not good.all():
                places = np.arange(len(x))
                x = np.interp(places, places[good], x[good])
                i = np.interp(places, places[good], i[good])
            rows.append(
                _windows(
                    plant.travel_m - x if downwards else x, _mean_square(i, u, step, amplifier), step, width, plant
                )
            )
    return rows


def _cut(flight: slice, width: int) -> list[slice]:
    starts = range(flight.start, flight.stop, _CONVOLVED)
    return [slice(a, min(a + _CONVOLVED, flight.stop)) for a in starts if min(a + _CONVOLVED, flight.stop) - a > width]


def _regress(table: FloatArray) -> BallStart:
    left, force, drag = table.T
    columns = np.column_stack((force, drag))
    solution, *_ = np.linalg.lstsq(columns, left, rcond=None)
    residual = left - force * solution[0] - drag * solution[1]
    middle = newey_west(columns * residual[:, None], OVERLAP * 2)
    inverse = np.linalg.pinv(columns.T @ columns)
    spread = float(np.sqrt(np.mean(force**2))) * abs(float(solution[0]))
    return BallStart(
        k=float(solution[0]),
        d=float(solution[1]),
        misfit=float(np.sqrt(np.mean(residual**2)) / max(spread, 1e-300)),
        windows=len(left),
        d_std=float(np.sqrt(max((inverse @ middle @ inverse)[1, 1], 0.0))),
    )


def newey_west(scores: FloatArray, lags: int) -> FloatArray:
    """Return the sum of scores, shape (n, m), that holds where neighbours depend on each other, shape (m, m).

    Source: Newey and West, Econometrica 55(3), 1987.
    """
    total = scores.T @ scores
    # The weights fall with the lag. With equal weights the sum need not be positive semidefinite, and a variance could
    # be negative.
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return np.asarray(total)


def _mean_square(i: FloatArray, u: FloatArray, step: float, amplifier: AmplifierStart | None) -> FloatArray:
    """Return the mean of i^2 over the interval that begins at each sample."""
    if amplifier is None or not np.isfinite(u).all():
        after = np.append(i[1:], i[-1])
        return np.asarray((i * i + i * after + after * after) / 3.0)
    # i = e + w exp(-t / T_A) by (1), squared and averaged in closed form.  Between samples 2 ms apart a fast amplifier
    # has settled.
    e = amplifier.K_A * u
    tau = amplifier.T_A
    w = i - e
    return np.asarray(
        e * e
        + 2.0 * e * w * (tau / step * (1.0 - np.exp(-step / tau)))
        + w * w * (0.5 * tau / step * (1.0 - np.exp(-2.0 * step / tau)))
    )


def _windows(x: FloatArray, square: FloatArray, step: float, width: int, plant: Plant) -> FloatArray:
    s = np.linspace(-1.0, 1.0, width + 1)
    reach_s = 0.5 * width * step
    # M. Shinbrot, On the analysis of linear and nonlinear systems, Transactions of the ASME 79, 1957.  A filter would
    # need derivatives of noisy readings.
    phi = (1.0 - s**2) ** 3
    slope = -6.0 * s * (1.0 - s**2) ** 2 / reach_s
    bend = (-6.0 * (1.0 - s**2) ** 2 + 24.0 * s**2 * (1.0 - s**2)) / reach_s**2
    gap = np.maximum(plant.x_max_m - x, 0.01 * plant.travel_m)
    # The mean force of an interval belongs to its middle, where window and gap are evaluated.
    gap_middle = 0.5 * (gap[:-1] + gap[1:])
    force = square[:-1] / gap_middle**2
    phi_middle = (1.0 - (0.5 * (s[:-1] + s[1:])) ** 2) ** 3

    def slide(values: FloatArray, window: FloatArray) -> FloatArray:
        return np.asarray(np.convolve(values, window[::-1], mode="valid")[:: max(width // OVERLAP, 1)] * step)

    # Only differences of x matter; without its mean the sums over a window lose no digits.
    centred = x - np.mean(x)
    left = slide(centred, bend) + plant.gravity_m_s2 * float(np.sum(phi)) * step
    right = slide(force, phi_middle)
    drag = slide(centred, slope)
    n = min(len(left), len(right), len(drag))
    return np.column_stack((left[:n], right[:n], drag[:n]))
