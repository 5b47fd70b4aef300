"""The prediction error of a model without physics on the same recordings.

A ridge regression of the displacement N samples ahead on the last readings, on u_c up to then, and on random features
of both (A. Rahimi, B. Recht, Random features for large-scale kernel machines, NIPS 2007).  It is trained on the
recordings for fitting and evaluated on the judge recordings, like the physical model.

In a closed loop u_c depends on the readings, so the inputs after the last reading tell the regression where the ball
was.  Its error may even be below the noise floor of a physical model, for which u_c is an input alone.  A physical
model that predicts better is good in any case; one that predicts worse does not necessarily lack an effect.
"""

from __future__ import annotations

import numpy as np

from twin.estimation.innovations import FLIES, FOLLOWS
from twin.estimation.record import FloatArray
from twin.evidence.gather import Evidence

PAST = 4  # readings of x and i_c, and inputs before them
FEATURES = 600  # random ones, of the regression
MAX_WINDOWS = 20_000  # to train on: limits time and memory
_PENALTIES = tuple(10.0**power for power in range(-6, 3))  # a fifth of the windows chooses one


def flexible_errors(fit: Evidence, judge: Evidence, samples: int, seed: int) -> FloatArray:
    """Return x_hat - x of every sample of the judges, shape (n,), m; NaN where there is no window of flight before it.

    Args:
        fit: recordings to train on; a fifth of their windows chooses the penalty.
        judge: recordings to predict.
        samples: horizon.
        seed: of the features.
    """
    errors = np.full(len(judge.series), np.nan)
    ends, inputs, moved = _windows(fit, samples)
    predicted, rows, targets = _windows(judge, samples)
    if len(ends) < 20 * PAST or not len(predicted):
        return errors
    rng = np.random.default_rng(seed)
    if len(ends) > MAX_WINDOWS:
        chosen = np.sort(rng.choice(len(ends), MAX_WINDOWS, replace=False))
        # Drawn, not the first windows: those are of the first recordings alone.
        inputs, moved = inputs[chosen], moved[chosen]
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-12
    directions = rng.normal(size=(inputs.shape[1], FEATURES)) / np.sqrt(inputs.shape[1])
    phases = rng.uniform(0.0, 2.0 * np.pi, FEATURES)

    def features(values: FloatArray) -> FloatArray:
        scaled = (values - mean) / spread
        return np.hstack([np.ones((len(scaled), 1)), scaled, np.cos(scaled @ directions + phases)])

    train, unit = features(inputs), moved.std() + 1e-12
    first = np.arange(len(train)) % 500 < 400  # blocks: neighbouring windows share their readings
    # Chosen on the recordings for fitting: a penalty that the judges choose would make their error an optimistic one.
    best = min(_PENALTIES, key=lambda p: _missed(train, moved / unit, first, p))
    errors[predicted] = features(rows) @ _ridge(train, moved / unit, best) * unit - targets
    return errors


def _ridge(rows: FloatArray, targets: FloatArray, penalty: float) -> FloatArray:
    # A. E. Hoerl, R. W. Kennard, Ridge regression: biased estimation for nonorthogonal problems, 1970.  Plain least
    # squares would follow the noise with 600 features.
    return np.asarray(np.linalg.solve(rows.T @ rows + penalty * len(rows) * np.eye(rows.shape[1]), rows.T @ targets))


def _missed(
    rows: FloatArray, targets: FloatArray, first: np.ndarray[tuple[int], np.dtype[np.bool_]], p: float
) -> float:
    return float(np.mean((rows[~first] @ _ridge(rows[first], targets[first], p) - targets[~first]) ** 2))


def _windows(
    evidence: Evidence, samples: int
) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], FloatArray, FloatArray]:
    """Return (predicted sample, shape (w,); readings and inputs, shape (w, columns); displacement until it, m)."""
    series = evidence.series
    linked = (series.flags & (FLIES | FOLLOWS) == FLIES | FOLLOWS).astype(int)
    length = PAST + samples - 1  # steps from the first reading to the last
    run = np.convolve(linked, np.ones(length, int))[: len(linked)] if len(linked) else linked
    (ends,) = np.nonzero(run == length)
    now = ends - samples
    # Differences to the last reading, and the displacement as target: the regression need not learn that the ball stays
    # near its place.
    past = [series.x[now - k] - series.x[now] for k in range(1, PAST)] + [series.i[now - k] for k in range(PAST)]
    inputs = [series.u[now + k] for k in range(1 - PAST, samples)]
    return ends, np.column_stack([series.x[now], *past, *inputs]), series.x[ends] - series.x[now]
