"""The judge flights of a case: which rows count, what a right model leaves there, and the error of predictions.

Rule: a row counts if the ball has flown off its stops for `SETTLE_S` and no sample is missing within `UNBROKEN_S`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.emulator.plant.constants import PlantConstants
from protocol.campaign import Use, load
from tests.harness.twin.true_model import true_model
from twin.estimation.innovations import LOST
from twin.estimation.prediction_floor import floor_rmse
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.readers.campaign import read_campaign
from twin.validation.extended import system_of

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
AHEAD = 10  # samples: 20 ms
TICK_S, SETTLE_S, UNBROKEN_S = 2e-3, 0.25, 0.03
AT_A_STOP = 0.03  # of the travel


def flights(case: Path, use: Use) -> Iterator[tuple[Record, BoolArray]]:
    """The closed-loop recordings and which of their rows count, shape (n,)."""
    campaign = load(case)
    for record in read_campaign(campaign, use=use):
        if record.kind == "closed-loop":
            yield record, counted(record.t, record.x, campaign.plant.travel_m)


def counted(t: FloatArray, x: FloatArray, travel_m: float) -> BoolArray:
    """Tell which rows count, shape (n,)."""
    touches = ~((x > AT_A_STOP * travel_m) & (x < (1.0 - AT_A_STOP) * travel_m))
    last_touch = np.maximum.accumulate(np.where(touches, t, t[0]))
    rows = round(UNBROKEN_S / TICK_S)
    unbroken = np.zeros(len(t), dtype=bool)
    unbroken[rows:] = np.abs(t[rows:] - t[:-rows] - UNBROKEN_S) < 0.1 * TICK_S
    return np.asarray((t - last_touch >= SETTLE_S) & unbroken)


def stamp(t_s: float) -> int:
    """A time as a key, in tenths of milliseconds."""
    return round(t_s * 1e4)


def error_m(case: Path, predicted: Mapping[tuple[str, int], float]) -> float:
    """Root mean square error of x 20 ms ahead on the rows that count, m; a missing prediction: x stays where it was.

    Args:
        case: Its folder.
        predicted: x in m by (file, `stamp` of its time).
    """
    squares = []
    for record, counts in flights(case, "judge"):
        for row in np.flatnonzero(counts).tolist():
            key = record.name, stamp(float(record.t[row]))
            squares.append((predicted.get(key, float(record.x[row - AHEAD])) - record.x[row]) ** 2)
    return float(np.sqrt(np.mean(squares)))


def floor_m(case: Path, rig: PlantConstants, effects: Mapping[str, float]) -> float:
    """The error that the true numbers of the rig leave, by the covariance of a Kalman filter (S 7), m.

    Args:
        case: Its folder.
        rig: The constants that were drawn, with the noise of both sensors.
        effects: Those whose formula the twin has, by name.
    """
    model = true_model(rig, effects)
    model = replace(model, noise=replace(model.noise, process_a_m_s2=0.0, process_i_c_a=0.0))
    total, number = 0.0, 0
    for record, counts in flights(case, "judge"):
        evidence = gather([record], model.plant)
        rows = np.zeros(len(evidence.series.flags), dtype=bool)
        rows[evidence.series.flags & LOST == 0] = counts  # the series has a row for a lost sample
        rmse_m = floor_rmse(system_of(model, record)._replace(closed_form=False), evidence.samples, AHEAD, rows)
        total, number = total + float(counts.sum()) * rmse_m**2, number + int(counts.sum())
    return float(np.sqrt(total / number))
