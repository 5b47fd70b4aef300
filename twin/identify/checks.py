"""Is this recording what it says it is?  Wrong units, swapped columns, reversed signs: recognised, said, never fitted.

Rule 1: what would give a wrong number silently is a DataError with the line to change; what only costs information is a
        warning and the recording goes on without that part.
Rule 2: a test must be wrong about no real recording: each looks for a factor of several, not for a percentage.
"""

from __future__ import annotations

import numpy as np

from protocol.campaign import Controller, Plant
from protocol.errors import DataError
from twin.identify.liftoff import lift_offs
from twin.identify.prepare import flights
from twin.identify.record import FloatArray, Record
from twin.identify.start import amplifier_start, ball_start

_BALL = ("prbs", "closed-loop", "free", "sawtooth")
CURRENT_MOST_A = 30.0  # no laboratory coil of this size takes it; 30 mA would not lift a ball either
INTERVAL_MOST_S = 0.2  # slower than this no ball is controlled, so t is not in seconds


def inspect(records: list[Record], plant: Plant, controller: Controller | None) -> list[str]:
    """Warnings about the recordings of a campaign.

    Raises:
        DataError: a channel is not what its column says: unit, sign, or mixed up with another.
    """
    warnings: list[str] = []
    for record in records:
        _time(record)
        _current(record)
        _position(record, plant)
        _swapped(record, plant)
        warnings += _idle(record, plant)
        if controller is not None and record.kind == "closed-loop":
            warnings += _law(record, plant, controller)
    _downwards(records, plant)
    return warnings


def _time(record: Record) -> None:
    if record.kind == "equilibria" or not len(record.t) or (record.captures and len(record.t) < 3):
        return
    step = record.interval_s
    if not np.isfinite(step):
        raise DataError(f"{record.name}: t never rises", remedy="Map t to the column with the time in seconds")
    if step > INTERVAL_MOST_S:
        unit = "milliseconds" if step < 100 else "microseconds"
        scale = "1e-3" if step < 100 else "1e-6"
        raise DataError(
            f"{record.name}: samples are {step:g} s apart; t looks like {unit}",
            remedy=f"Write t = {{ column = ..., scale = {scale} }}",
        )


def _current(record: Record) -> None:
    if not record.has("i_c"):
        return
    top = float(np.nanpercentile(np.abs(record.i_c), 99))
    if record.has("x") and record.kind != "amplifier-step":
        reach = float(np.nanpercentile(np.abs(record.x), 99))
        if top < 0.05 < reach < CURRENT_MOST_A:
            raise DataError(
                f"{record.name}: i_c stays below {top:.3g} A while x reaches {reach:.3g} m; they look swapped",
                remedy="Exchange the columns of i_c and x",
            )
    if top > CURRENT_MOST_A:
        raise DataError(
            f"{record.name}: i_c reaches {top:.4g} A; it looks like milliamperes",
            remedy="Write i_c = { column = ..., scale = 1e-3 }",
        )
    if record.has("u_c") and float(np.nanmedian(record.i_c)) * float(np.nanmedian(record.u_c)) < 0 and top > 0.05:
        raise DataError(
            f"{record.name}: i_c and u_c have opposite signs",
            remedy="Give the reversed one scale = -1.0: a positive u_c drives a positive i_c",
        )


def _position(record: Record, plant: Plant) -> None:
    if not record.has("x") or record.kind == "amplifier-step":
        return
    low, high = (float(v) for v in np.nanpercentile(record.x, (1, 99)))
    reach = max(abs(low), abs(high))
    travel = plant.travel_m
    for unit, scale in (("millimetres", 1e3), ("centimetres", 1e2), ("micrometres", 1e6)):
        if 0.15 * scale < reach / travel < 1.5 * scale:
            raise DataError(
                f"{record.name}: x reaches {reach:.4g} m in a travel of {travel:g} m; it looks like {unit}",
                remedy=f"Write x = {{ column = ..., scale = {1 / scale:g} }}",
            )
    if high < 0.1 * travel and low < -0.15 * travel and -low < 1.5 * travel:
        raise DataError(
            f"{record.name}: x runs from {low:.4g} to {high:.4g} m; it looks measured downwards",
            remedy=f"Write x = {{ column = ..., offset = {travel:g} }}, or scale = -1.0 for a reversed sign",
        )
    if low < -0.3 * travel or high > 1.3 * travel:
        raise DataError(
            f"{record.name}: x runs from {low:.4g} to {high:.4g} m, the travel is 0 to {travel:g} m",
            remedy="x is up from the ball's lowest position, in m: correct scale and offset of its column, or travel_m",
        )


def _swapped(record: Record, plant: Plant) -> None:
    if record.has("x", "x_ref") and record.kind == "closed-loop":
        still = [float(np.mean(np.diff(values) == 0.0)) for values in (record.x, record.x_ref)]
        if 0.9 < still[0] < 1.0 and still[1] < 0.5:
            raise DataError(
                f"{record.name}: x stands still for {100 * still[0]:.0f} % of the samples while x_ref moves; swapped",
                remedy="Exchange the columns of x and x_ref",
            )
    if not record.has("u_c", "i_c") or record.kind == "equilibria" or len(record.t) < 200:
        return
    lag, peak = _lag(record.u_c, record.i_c)
    if lag < 0 and peak > 0.4:
        raise DataError(
            f"{record.name}: i_c changes {-lag} sample(s) before u_c does (correlation {peak:.2f}); they look swapped",
            remedy="Exchange the columns of u_c and i_c, or shift u_c: it is the input from its sample on",
        )


def _lag(u: FloatArray, i: FloatArray, most: int = 3) -> tuple[int, float]:
    """(by how many samples i follows u, correlation of their changes there)."""
    du, di = np.diff(u), np.diff(i)
    good = np.isfinite(du) & np.isfinite(di)
    du, di = np.where(good, du, 0.0), np.where(good, di, 0.0)
    norm = float(np.linalg.norm(du) * np.linalg.norm(di))
    if norm == 0.0:
        return 0, 0.0
    n = len(du)
    values = {
        lag: float(du[max(0, -lag) : n - max(0, lag)] @ di[max(0, lag) : n - max(0, -lag)]) / norm
        for lag in range(-most, most + 1)
    }
    best = max(values, key=lambda lag: values[lag])
    return best, values[best]


def _idle(record: Record, plant: Plant) -> list[str]:
    said = []
    for channel, what in (("u_c", "V"), ("i_c", "A"), ("x", "m")):
        values = getattr(record, channel)
        known = values[np.isfinite(values)]
        wanted = channel != "x" or record.kind in _BALL
        if record.kind != "equilibria" and wanted and known.size > 10 and np.ptp(known) == 0.0:
            said.append(
                f"{record.name}: {channel} is {known[0]:g} {what} throughout; a constant channel tells nothing. "
                "Check its column"
            )
    if record.kind in ("prbs", "closed-loop", "free") and record.has("x") and not flights(record, plant):
        said.append(
            f"{record.name}: the ball never leaves its stops, so it says nothing of K_c and b. Raise the amplitude"
        )
    if record.kind == "sawtooth" and record.has("x", "i_c") and not lift_offs([record], plant):
        said.append(
            f"{record.name}: no clean lift-off (the ball stays, or creeps before it leaves), so no current for (8). "
            "Raise the end of the ramp, or steady the ball"
        )
    return said


def _downwards(records: list[Record], plant: Plant) -> None:
    chosen = [r for r in records if r.kind in ("prbs", "closed-loop", "free") and r.has("x", "i_c")]
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
        for point in lift_offs([_upside_down(record, plant)], plant)
    ]
    if falling and not rising:
        raise DataError(
            f"{falling[0].recording}: x falls where the rising current pulls the ball up; it is measured downwards",
            remedy=f"Write x = {{ column = ..., scale = -1.0, offset = {plant.travel_m:g} }}",
        )


def _upside_down(record: Record, plant: Plant) -> Record:
    return Record(
        name=record.name,
        kind=record.kind,
        use=record.use,
        t=record.t,
        u_c=record.u_c,
        i_c=record.i_c,
        x=plant.travel_m - record.x,
        x_ref=record.x_ref,
    )


def _law(record: Record, plant: Plant, controller: Controller) -> list[str]:
    """Whether u_c is what the controller section says, given the measured i_c, x, x_ref."""
    if not record.has("u_c", "i_c", "x", "x_ref"):
        return []
    longest = max(flights(record, plant), key=lambda s: s.stop - s.start, default=None)
    if longest is None or longest.stop - longest.start < 200:
        return []
    u, i, x, x_ref = (getattr(record, name)[longest] for name in ("u_c", "i_c", "x", "x_ref"))
    step = record.interval_s
    speed = np.append(np.nan, np.diff(x)) / step
    error = np.where(np.isfinite(x_ref - x), x_ref - x, 0.0)
    integral = np.append(0.0, np.cumsum(error)[:-1]) * step
    point, gains = controller.operating_point, np.array(controller.gains)
    if controller.kind == "lqi":
        columns = np.column_stack((-(i - point.i_c_a), -(x - point.x_m), -speed, -integral))
    else:
        columns = np.column_stack((x_ref - x, integral, -speed, np.zeros(len(x))))
    inside = (u > np.nanmin(record.u_c)) & (u < np.nanmax(record.u_c)) & np.isfinite(columns).all(axis=1)
    columns, u = columns[inside][5:], u[inside][5:]
    if len(u) < 100:
        return []
    off = u - columns @ gains
    off = off - np.mean(off)  # the integral began before the recording
    spread = float(np.std(u))
    table = np.column_stack((columns, np.ones(len(u))))
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-12)
    found = np.linalg.lstsq(table / scale, u, rcond=None)[0] / scale
    rest = float(np.std(u - table @ found))
    if float(np.std(off)) > max(3.0 * rest, 0.2 * spread):
        fitted = ", ".join(f"{value:.4g}" for value in found[:4])
        share = 100.0 * (1.0 - (rest / spread) ** 2) if spread > 0 else 0.0
        return [
            f"{record.name}: u_c is not what [controller] gives (off by {np.std(off):.3g} V rms); it follows "
            f"gains of about [{fitted}] (they explain {share:.0f} % of it). Correct it; the fit does not use it"
        ]
    return []
