"""Predictions of one recording by a model, N samples ahead, and their error.  Pure.

Rule 1: the noise levels are those of the model plus the quantisation of this recording.
Rule 2: u_c is delayed only for a model whose identification found that delay.
Rule 3: samples without a prediction are counted by reason; none is left out because of its error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from protocol.errors import DataError
from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_X
from twin.estimation.record import BoolArray, FloatArray, Record
from twin.estimation.rollout import SETTLE_S, within_reach
from twin.estimation.rollout_periodic import has_phase
from twin.estimation.rollout_periodic import predict as predict_readings
from twin.estimation.structures import AT_THE_ENDS
from twin.evidence.gather import gather
from twin.model.causes.catalogue import cause_of_detector
from twin.model.extended import position_reading
from twin.model.extension import base, vector
from twin.model.parameters import Model
from twin.validation.extended import system_of
from twin.validation.source import source_of

NEEDED = ("u_c", "i_c", "x")


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Readings and their predictions, arrays of shape (count,), and the samples left out."""

    ahead: int  # horizon N in samples
    interval_s: float
    t: FloatArray  # s, of the samples predicted
    x: FloatArray  # m, measured
    x_hat: FloatArray  # m, predicted
    samples: int  # of the recording
    left_out: tuple[tuple[str, int], ...]  # (reason, samples)
    notes: tuple[str, ...]

    @property
    def rmse_m(self) -> float | None:
        """Return the root mean square of x - x_hat, m; None without a prediction."""
        return float(np.sqrt(np.mean((self.x - self.x_hat) ** 2))) if len(self.x) else None


def predict(model: Model, record: Record, ahead: int) -> Prediction:
    """Predict every reading of x for which a prediction `ahead` samples earlier is possible.

    Args:
        model: with or without causes.
        record: with t, u_c, i_c and x.
        ahead: horizon N in samples, 1 or more.

    Raises:
        DataError: a channel is missing, or the recording is shorter than the horizon.
    """
    missing = [channel for channel in NEEDED if not record.has(channel)]
    if missing:
        raise DataError(
            f"{record.name} has no {' and no '.join(missing)}",
            remedy="A prediction takes t, u_c, i_c and x: map their columns in a campaign.toml and give --campaign",
        )
    if len(record.t) <= ahead + 1 or not np.isfinite(record.interval_s):
        raise DataError(
            f"{record.name} has {len(record.t)} samples, too few to predict {ahead} ahead",
            remedy="Give a longer recording, or a smaller --horizon",
        )
    source = source_of(replace(record, captures=()), model)
    recording = source.acting
    p, c = base(model), vector(model.causes)
    stops = (
        float(position_reading(p, c, 0.0, 0.0)),
        float(position_reading(p, c, p.travel_m, 0.0)),
    )
    evidence = gather([recording], model.plant, stops)
    s = evidence.series
    system = system_of(model, record)._replace(c=c, closed_form=False)  # the closed form has no lost samples
    x_hat = within_reach(predict_readings(system, evidence.samples, ahead), p, c, AT_THE_ENDS)
    sampled = s.flags & LOST == 0  # the series has a row for a lost sample, the recording has none
    flags, x_hat = s.flags[sampled], x_hat[sampled]
    predicted = np.isfinite(x_hat)
    notes = list(evidence.notes)
    if has_phase(c):
        notes.append(
            f"the phase of {cause_of_detector('spectral-line').name} comes from the readings before each prediction"
        )
    if source.delay:
        notes.append(f"u_c acts {source.delay} samples later than recorded, as where the model was identified")
    if source.unknown_delay:
        notes.append(f"u_c acts {source.unknown_delay} samples later than recorded, which the model does not include")
    return Prediction(
        ahead=ahead,
        interval_s=record.interval_s,
        t=record.t[predicted],
        x=record.x[predicted],
        x_hat=x_hat[predicted],
        samples=len(record.t),
        left_out=_left_out(flags, predicted),
        notes=tuple(notes),
    )


def _left_out(flags: NDArray[np.uint16], predicted: BoolArray) -> tuple[tuple[str, int], ...]:
    """Return the number of samples without a prediction, by the first reason that applies."""
    flies, reads = flags & FLIES != 0, flags & USE_X != 0
    contact = ~flies
    unread = flies & ~reads & ~predicted
    begun = ~(predicted | contact | unread)
    gaps = int(np.count_nonzero(flags[1:] & FOLLOWS == 0))
    return tuple(
        (why, count)
        for why, count in (
            ("at a stop, or in a flight too short to use", int(contact.sum())),
            ("no reading of x, or an outlier", int(unread.sum())),
            (f"within {SETTLE_S:g} s and the horizon of the start of a flight ({gaps} gaps in time)", int(begun.sum())),
        )
        if count
    )
