"""Adequacy: does the model leave nothing but sensor noise?

Rule 1: a model is adequate if its innovations are white and as large as the sensor noise makes them, (S 6).
Rule 2: small departures have no physical cause: converters round and the filter linearises.  The limits are in
        `twin/settings/diagnosis.py`.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from twin.estimation.innovations import FLIES
from twin.estimation.whiteness import whiteness
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.settings import diagnosis as settings


def adequate(criterion: Criterion, fit: Fit, floor: Floor) -> tuple[bool, str]:
    """Return whether the model is adequate, and if not, a sentence with the reason; `floor` is that of this model."""
    _, white = criterion.white(fit.theta)
    colour = whiteness(criterion.evidence.series, white)
    # Size before colour: a large rest is coloured as well, and its size is the clearer sentence.
    if floor.measured and floor.above_noise(fit.loglik):
        per_reading = floor.excess(fit.loglik) / floor.readings
        return False, (
            f"what is left is larger than the sensor noise: {per_reading:.2f} of log-likelihood per reading are missing"
        )
    if floor.misplaced_m > settings.MISPLACED_STOP_M:
        return False, f"it needs {_misplaced(floor)}; if the travel in the campaign file is wrong, correct it there"
    # Both bars: 0.06 keeps out what rounding does in a long campaign, the standard errors what chance does in a short
    # one.
    # 1 / sqrt(n) is the standard error in white noise (G. M. Ljung, G. E. P. Box, Biometrika 65(2), 1978).
    counts = [count for count in np.isfinite(white).sum(axis=0).tolist() if count]
    chance = settings.AUTOCORRELATION_ERRORS / math.sqrt(min(counts)) if counts else math.inf
    if colour.worst > max(settings.MAX_AUTOCORRELATION, chance):
        return False, f"what is left is not white: its autocorrelation reaches {colour.worst:.2f}"
    return True, ""


def _misplaced(floor: Floor) -> str:
    return f"a stop {floor.misplaced_m * 1e3:.2f} mm from its position in [plant]"


def where_left(criterion: Criterion, fit: Fit, floor: Floor) -> str:
    """Say where the innovations are largest: recording, channel and height, or a stop if only that is wrong."""
    if floor.misplaced_m > settings.MISPLACED_STOP_M and not (floor.measured and floor.above_noise(fit.loglik)):
        return f"at rest: the model needs {_misplaced(floor)}"
    series = criterion.evidence.series
    _, white = criterion.white(fit.theta)
    names = criterion.evidence.names()
    worst: list[tuple[float, str]] = []
    for column, channel in ((0, "i_c"), (1, "x")):
        values = white[:, column] ** 2
        for number, name in enumerate(names):
            values_of_recording = values[(series.recording == number) & np.isfinite(values)]
            if len(values_of_recording) >= 100:
                worst.append((float(values_of_recording.mean()), f"{channel} in {name}"))
    flying = (series.flags & FLIES != 0) & np.isfinite(white[:, 1])
    parts = []
    if worst:
        largest = max(worst)
        parts.append(f"most in {largest[1]} (mean square {largest[0]:.2g} times its share)")
    if flying.sum() > 500:
        x, w = series.x[flying], white[flying, 1] ** 2
        # Fifths of the readings, not of the travel: each mean then rests on as many readings as the others.
        edges = np.quantile(x, np.linspace(0.0, 1.0, 6))
        means = [float(w[(x >= a) & (x <= b)].mean()) for a, b in pairwise(edges)]
        index = int(np.argmax(means))
        if means[index] > settings.UNEVEN_SQUARE * min(means):
            parts.append(f"with the ball at {edges[index] * 1e3:.2f} to {edges[index + 1] * 1e3:.2f} mm")
    return "; ".join(parts)
