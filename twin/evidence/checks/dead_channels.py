"""Channels without information: constant channels, and a position that does not respond to the force.

Rule: such a channel is removed from its recording and reported.  Otherwise it would be fitted.  An x of sensor noise
      with a varying current gives a K_c that is 5 % wrong with an interval of 1 %.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from protocol.campaign import Plant
from twin.estimation.prepare import flights, scatter
from twin.estimation.record import FloatArray, Record
from twin.evidence.starting.regression import OVERLAP, force_rows
from twin.settings import identification as settings

FLYING = ("prbs", "closed-loop", "free")
_ABSENT = float("nan")


def without_dead(records: list[Record], plant: Plant) -> tuple[list[Record], list[str]]:
    """Return (the recordings without such channels, a sentence on each that was removed)."""
    retained: list[Record] = []
    messages: list[str] = []
    for record in records:
        if record.kind != "equilibria":
            record, constant = _without_constant(record)
            record, unmoving = _without_unmoving(record, plant)
            messages += constant + unmoving
        retained.append(record)
    return retained, messages


def at_rest(record: Record) -> bool:
    """Return whether the input is absent or constant, so that the recording shows noise only."""
    return record.kind == "free" and (not record.has("u_c") or _constant(record.u_c))


def _constant(values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    return known.size > settings.CONSTANT_SAMPLES and float(np.ptp(known)) == 0.0


def _without_constant(record: Record) -> tuple[Record, list[str]]:
    if at_rest(record):
        return record, []
    messages: list[str] = []
    for channel, unit in (("u_c", "V"), ("i_c", "A"), ("x", "m")):
        values = getattr(record, channel)
        if not _constant(values) or (channel == "x" and record.kind == "amplifier-step"):
            continue
        messages.append(
            f"{record.name}: {channel} is {values[np.isfinite(values)][0]:g} {unit} throughout; a constant channel "
            "has no information and was left out. Check its column"
        )
        absent: dict[str, Any] = {channel: np.full(len(values), _ABSENT)}
        record = replace(record, **absent)
    return record, messages


def _without_unmoving(record: Record, plant: Plant) -> tuple[Record, list[str]]:
    """The recording without x if x shows no motion although the force changes, and a sentence on that."""
    if record.kind not in FLYING or not record.has("i_c", "x"):
        return record, []
    parts = flights(record, plant, min_samples=2 * round(settings.WINDOW_S / record.interval_s))
    if not parts:
        return record, []
    spread = float(np.sqrt(np.nanmean(np.concatenate([(record.x[p] - np.nanmean(record.x[p])) ** 2 for p in parts]))))
    known = record.x[np.isfinite(record.x)]
    if spread > settings.UNMOVING_SPREAD * scatter(known):
        return record, []
    rows = force_rows([record], plant, None, settings.WINDOW_S)
    if not rows:
        return record, []
    left, force, _ = np.concatenate(rows).T
    # The response of x against that which (6) demands: a ball held still has none, and a noisy free ball has all of it.
    whole = float(left.mean() / force.mean())  # K_c / m by the weight alone
    change = force - force.mean()
    power = float(change @ change)
    if power <= 0.0:
        return record, []
    answer = float(change @ (left - left.mean())) / power
    rest = left - left.mean() - answer * change
    error = float(np.sqrt(OVERLAP * np.mean(rest**2) / power))
    if answer > settings.ANSWER_SHARE * whole or whole - answer < settings.ANSWER_ERRORS * error:
        return record, []
    return replace(record, x=np.full(len(record.x), _ABSENT)), [
        f"{record.name}: x is only noise ({spread * 1e6:.3g} um about {np.nanmean(known) * 1e3:.3g} mm), although "
        f"the force on the ball changes by {100 * float(np.std(force)) / abs(float(force.mean())):.2g} %: the ball is "
        "held, or the sensor does not see it. x was left out. Check the sensor and its column"
    ]
