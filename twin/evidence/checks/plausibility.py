"""Plausibility of recordings: wrong units, exchanged columns and reversed signs are recognised before the fit.

Rule 1: a mistake that would give a wrong model is a DataError with the line to change.  One that only costs information
        is a warning, and the recording is used without that part.
Rule 2: no test may reject a correct recording, so each needs a clear factor and not just a few percent.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from protocol.campaign import Controller, Plant
from protocol.errors import DataError
from protocol.plant import objections
from twin.estimation.prepare import flights
from twin.estimation.record import Record
from twin.evidence.checks.control_law import law_gap, numbers_of
from twin.evidence.checks.dead_channels import FLYING, at_rest
from twin.evidence.checks.mixed_channels import downwards, swapped
from twin.evidence.starting.liftoff import lift_offs
from twin.settings import identification as settings

_LENGTHS = (("millimetres", 1e3), ("centimetres", 1e2), ("micrometres", 1e6))


def inspect(records: list[Record], plant: Plant, controller: Controller | None) -> list[str]:
    """Check the recordings of a campaign; returns warnings.

    Raises:
        DataError: a channel has a wrong unit or sign, or is exchanged with another, or x_max is within the travel.
    """
    impossible = next((objection for objection in objections(asdict(plant)) if objection.is_error), None)
    if impossible is not None:
        raise DataError(f"[plant] {impossible.key}: {impossible.problem}", remedy=impossible.remedy)
    warnings: list[str] = []
    for record in records:
        warnings += _time(record)
        swapped(record, plant)
        warnings += _input(record)
        _current(record)
        _position(record, plant)
        reference = _reference(record, plant)
        warnings += reference + _idle(record, plant)
        if controller is not None and record.kind == "closed-loop" and not reference:
            warnings += _law(record, plant, controller)
    downwards(records, plant)
    return warnings


def _time(record: Record) -> list[str]:
    if record.kind == "equilibria" or not len(record.t) or (record.captures and len(record.t) < 3):
        return []
    step = record.interval_s
    if not np.isfinite(step):
        raise DataError(f"{record.name}: t never rises", remedy="Map t to the column with the time in seconds")
    if step > settings.MAX_INTERVAL_S:
        unit = "milliseconds" if step < 100 else "microseconds"
        scale = "1e-3" if step < 100 else "1e-6"
        raise DataError(
            f"{record.name}: samples are {step:g} s apart; t looks like {unit}",
            remedy=f"Write t = {{ column = ..., scale = {scale} }}",
        )
    steps = np.diff(record.t)
    steps = steps[np.isfinite(steps)]
    stuck = int(np.count_nonzero(steps <= 0.0))
    if stuck > settings.REPEATED_SHARE * len(steps):
        raise DataError(
            f"{record.name}: t does not rise at {stuck} of {len(steps)} samples",
            remedy="Remove doubled rows, or give t more digits",
        )
    messages = []
    if stuck:
        messages.append(f"{record.name}: t does not rise at {stuck} samples; each begins a new piece")
    regular = steps[(steps > 0.0) & (steps < 10.0 * step)]
    # A lost sample doubles the interval of a regular clock.
    beats = np.maximum(np.rint(regular / step), 1.0)
    missing = int((beats - 1.0).sum())
    low, high = np.percentile(regular / beats, (5, 95))
    if high - low > settings.INTERVAL_SPREAD * step:
        messages.append(
            f"{record.name}: the sampling interval varies, {low * 1e3:.4g} to {high * 1e3:.4g} ms for nine in ten; "
            "each sample is predicted over its own"
        )
    elif missing:
        messages.append(
            f"{record.name}: {missing} samples are missing among {len(record.t)}; look for the cause: the "
            "line, its adapter, a busy computer"
        )
    return messages


def _input(record: Record) -> list[str]:
    if not record.has("u_c"):
        return []
    low, high = (float(v) for v in np.nanpercentile(record.u_c, (1, 99)))
    if max(abs(low), abs(high)) > settings.MAX_INPUT_V:
        raise DataError(
            f"{record.name}: u_c reaches {max(abs(low), abs(high)):.4g} V; it looks like millivolts or counts",
            remedy="Write u_c = { column = ..., scale = 1e-3 }, or the volts of a count",
        )
    if high < 0.0 and record.has("i_c") and float(np.nanpercentile(record.i_c, 99)) < 0.0:
        return [
            f"{record.name}: u_c and i_c are negative throughout: their polarity is reversed. This matters for "
            "lift-off (8) and [controller], not for the force: give both scale = -1.0"
        ]
    return []


def _current(record: Record) -> None:
    if not record.has("i_c"):
        return
    top = float(np.nanpercentile(np.abs(record.i_c), 99))
    if top > settings.MAX_CURRENT_A:
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
    for unit, scale in _LENGTHS:
        if 0.15 * scale < reach / travel < 1.5 * scale:
            raise DataError(
                f"{record.name}: x reaches {reach:.4g} m in a travel of {travel:g} m; it looks like {unit}",
                remedy=f"Write x = {{ column = ..., scale = {1 / scale:g} }}; for a sensor's voltage measure "
                "heights and write table = [[V, m], ...]",
            )
    if high < 0.1 * travel and low < -0.15 * travel and -low < 1.5 * travel:
        raise DataError(
            f"{record.name}: x runs from {low:.4g} to {high:.4g} m; it looks measured downwards",
            remedy=f"Write x = {{ column = ..., offset = {travel:g} }}, or scale = -1.0 for a reversed sign",
        )
    if low < -0.3 * travel or high > 1.3 * travel:
        raise DataError(
            f"{record.name}: x runs from {low:.4g} to {high:.4g} m, the travel is 0 to {travel:g} m"
            + (", assumed: nobody stated the plant of this rig" if plant.assumed else ""),
            remedy="x is up from the ball's lowest position, in m: correct scale and offset of its column, or travel_m",
        )


def _reference(record: Record, plant: Plant) -> list[str]:
    """Return the warnings about x_ref, which is not fitted: a wrong one affects the closed loop only."""
    if record.kind != "closed-loop" or not record.has("x", "x_ref"):
        return []
    travel = plant.travel_m
    reach = float(np.nanpercentile(np.abs(record.x_ref), 99))
    for unit, scale in _LENGTHS:
        if 0.15 * scale < reach / travel < 1.5 * scale:
            return [
                f"{record.name}: x_ref reaches {reach:.4g} m in a travel of {travel:g} m; it looks like {unit}. "
                f"Write x_ref = {{ column = ..., scale = {1 / scale:g} }}"
            ]
    away = float(np.nanmedian(np.abs(record.x - record.x_ref)))
    turned = float(np.nanmedian(np.abs(record.x - (travel - record.x_ref))))
    moves = float(np.nanstd(record.x)), float(np.nanstd(record.x_ref))
    if min(moves) > 0.02 * travel and turned < 0.3 * away:
        return [
            f"{record.name}: x follows travel - x_ref: x_ref looks measured downwards. "
            f"Write x_ref = {{ column = ..., scale = -1.0, offset = {travel:g} }}"
        ]
    return []


def _idle(record: Record, plant: Plant) -> list[str]:
    messages = []
    if record.kind in FLYING and not at_rest(record) and record.has("x") and not flights(record, plant):
        messages.append(
            f"{record.name}: the ball never leaves its stops, so it does not show K_c and b. Raise the amplitude"
        )
    if record.kind == "sawtooth" and record.has("x", "i_c") and not lift_offs([record], plant):
        messages.append(
            f"{record.name}: no clean lift-off (the ball stays, or creeps before it leaves), so no current for (8). "
            "Raise the end of the ramp, or steady the ball"
        )
    return messages


def _law(record: Record, plant: Plant, controller: Controller) -> list[str]:
    """A warning if u_c contradicts the [controller], given the measured i_c, x, x_ref."""
    if not np.isfinite(record.interval_s) or not record.has("u_c"):
        return []
    numbers = numbers_of(controller, record.interval_s)
    gap = law_gap(record, plant, numbers) if numbers is not None else None
    if gap is None or not gap.contradicted:
        return []
    return [
        f"{record.name}: u_c is not what [controller] gives (off by {gap.off_v:.3g} V, {100 * gap.share:.0f} % of its "
        f"movement); {gap.text()}. Correct it; the fit does not use it"
    ]
