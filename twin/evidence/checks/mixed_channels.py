"""Exchanged channels, and x measured downwards; recognised by physics and causality.

Rule: as in `plausibility.py`, each test needs a clear factor and not just a few percent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from protocol.campaign import Plant
from protocol.errors import DataError
from twin.estimation.prepare import scatter
from twin.estimation.record import FloatArray, Record
from twin.evidence.checks.dead_channels import FLYING
from twin.evidence.starting.liftoff import lift_offs
from twin.evidence.starting.regression import amplifier_start, ball_start
from twin.settings import identification as settings


def swapped(record: Record, plant: Plant) -> None:
    """Check for exchanged columns.

    Raises:
        DataError: two columns are exchanged; the message names them.
    """
    if record.kind == "equilibria":
        return
    _lengths(record, plant)
    if record.kind == "closed-loop" and record.has("x", "x_ref"):
        _reference(record)
    if not record.has("u_c", "i_c") or len(record.t) < 200:
        return
    lag, peak = _lag(record.u_c, record.i_c)
    if lag < 0 and peak > 0.4:
        raise DataError(
            f"{record.name}: i_c changes {-lag} sample(s) before u_c does (correlation {peak:.2f}); they look swapped",
            remedy="Exchange the columns of u_c and i_c, or shift u_c: it is the input from its sample on",
        )


def _lengths(record: Record, plant: Plant) -> None:
    """Check whether i_c or u_c has the range of a position in metres while x has not."""
    if not record.has("x") or record.kind == "amplifier-step":
        return
    reach = float(np.nanpercentile(np.abs(record.x), 99))
    for channel, unit in (("i_c", "A"), ("u_c", "V")):
        if not record.has(channel):
            continue
        values = getattr(record, channel)
        low, high = (float(v) for v in np.nanpercentile(values, (1, 99)))
        as_length = low > -0.3 * plant.travel_m and high < min(1.3 * plant.travel_m, settings.MIN_CURRENT_A)
        moves = float(np.nanstd(values)) > 0.01 * plant.travel_m
        if (
            as_length
            and moves
            and 1.3 * plant.travel_m < reach < settings.MAX_CURRENT_A
            and reach > settings.MIN_CURRENT_A
        ):
            raise DataError(
                f"{record.name}: {channel} stays below {high:.3g} {unit} while x reaches {reach:.3g} m; they look "
                "swapped",
                remedy=f"Exchange the columns of {channel} and x",
            )


def _reference(record: Record) -> None:
    x, x_ref = record.x, record.x_ref
    unchanged = [float(np.mean(np.diff(values) == 0.0)) for values in (x, x_ref)]
    if 0.9 < unchanged[0] < 1.0 and unchanged[1] < 0.5:
        raise DataError(
            f"{record.name}: x stands still for {100 * unchanged[0]:.0f} % of the samples while x_ref moves; swapped",
            remedy="Exchange the columns of x and x_ref",
        )
    both = np.isfinite(x) & np.isfinite(x_ref)
    if both.sum() < 200 or not scatter(x_ref[both]) > 3.0 * scatter(x[both]):
        return
    # Exchanged only if x_ref is noisier than x and also follows it.
    max_lag = max(round(settings.RESPONSE_S / record.interval_s), 1)
    smooth = np.full(5, 0.2)
    lag, peak = _lag(np.convolve(x_ref[both], smooth, "valid"), np.convolve(x[both], smooth, "valid"), max_lag)
    if lag < 0 and peak > 0.4:
        raise DataError(
            f"{record.name}: x changes {-lag} samples before x_ref, and x_ref is the noisy one; they look swapped",
            remedy="Exchange the columns of x and x_ref",
        )


def _lag(u: FloatArray, i: FloatArray, max_lag: int = 3) -> tuple[int, float]:
    """Return (lag of i behind u in samples, correlation of their changes at that lag)."""
    du, di = np.diff(u), np.diff(i)
    good = np.isfinite(du) & np.isfinite(di)
    du, di = np.where(good, du, 0.0), np.where(good, di, 0.0)
    norm = float(np.linalg.norm(du) * np.linalg.norm(di))
    if norm == 0.0:
        return 0, 0.0
    n = len(du)
    # Correlations of the changes, not of the values: slow ramps correlate at any lag.
    values = {
        lag: float(du[max(0, -lag) : n - max(0, lag)] @ di[max(0, lag) : n - max(0, -lag)]) / norm
        for lag in range(-max_lag, max_lag + 1)
    }
    best = max(values, key=lambda lag: values[lag])
    return best, values[best]


def downwards(records: list[Record], plant: Plant) -> None:
    """Check by the amplifier, the force and the lift-off for a reversed current and for x measured downwards.

    Raises:
        DataError: a sign is reversed; the message names the recording and the line to change.
    """
    chosen = [r for r in records if r.kind in FLYING and r.has("x", "i_c")]
    amplifier = amplifier_start(records)
    if amplifier is not None and amplifier.K_A <= 0:
        raise DataError(
            f"{records[0].name}: i_c falls where u_c rises (K_A = {amplifier.K_A:.3g} A/V)",
            remedy="Give the reversed column scale = -1.0, or exchange columns",
        )
    for record in chosen:
        up = ball_start([record], plant, amplifier)
        down = ball_start([record], plant, amplifier, downwards=True)
        if up is None or down is None or up.windows < 10:
            continue
        if down.k > 0 and down.misfit < 0.33 * up.misfit:
            raise DataError(
                f"{record.name}: the force fits {up.misfit / down.misfit:.0f} times better with x downwards",
                remedy=f"Write x = {{ column = ..., scale = -1.0, offset = {plant.travel_m:g} }}, and so for x_ref",
            )
    rising = [point for record in records if record.kind == "sawtooth" for point in lift_offs([record], plant)]
    falling = [
        point
        for record in records
        if record.kind == "sawtooth" and record.has("x", "i_c")
        for point in lift_offs([replace(record, x=plant.travel_m - record.x)], plant)
    ]
    # Only if no ball rises: a single wrong departure must not turn a campaign around.
    if falling and not rising:
        raise DataError(
            f"{falling[0].recording}: x falls where the rising current pulls the ball up; it is measured downwards",
            remedy=f"Write x = {{ column = ..., scale = -1.0, offset = {plant.travel_m:g} }}",
        )
