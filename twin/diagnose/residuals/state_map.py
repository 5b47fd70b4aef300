"""An empirical correction: the mean prediction error as a function of position and speed, without a cause.

It is estimated on the recordings for fitting and evaluated on the judge recordings.

Rule 1: it serves prediction only.  It shows how much of the remaining error is a function of x and x', and not its
        cause.
Rule 2: each cell is shrunk towards 0 according to its uncertainty and smoothed over its neighbours, so a cell with few
        samples corrects little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from twin.diagnose.residuals.regimes import (
    Blocks,
    Estimate,
    by_edges,
    estimate,
    even_edges,
    means,
    shared_edges,
)
from twin.estimation.record import FloatArray

X_CELLS = 10
_V_SHARES = (0.0, 0.03, 0.15, 0.4, 0.6, 0.85, 0.97, 1.0)
_SMOOTH = 0.7  # cells


@dataclass(frozen=True, slots=True, kw_only=True)
class Correction:
    """The correction, to be subtracted from the predictions of the extended model."""

    x_edges_m: FloatArray
    v_edges_m_s: FloatArray
    offset_m: FloatArray  # mean of x_hat - x, shape (x cells, v cells)
    extended_rmse_m: float  # on the judge recordings
    corrected_rmse_m: float
    ratio: Estimate  # of corrected over extended


def correction(
    fit: tuple[FloatArray, FloatArray, FloatArray],
    judge: tuple[FloatArray, FloatArray, FloatArray],
    blocks: Blocks,
    judge_blocks: Blocks,
) -> Correction | None:
    """Estimate the correction on `fit` and evaluate it on `judge`; None with too few samples.

    Args:
        fit: error x_hat - x in m, and reading of x in m and speed in m/s at the start of each prediction, each of shape
            (n,).
        judge: the same of the judge recordings.
        blocks: of `fit`.
        judge_blocks: of `judge`.
    """
    known = [np.isfinite(e) & np.isfinite(x) & np.isfinite(v) for e, x, v in (fit, judge)]
    error, x, v = (np.where(known[0], values, np.nan) for values in fit)
    edges = even_edges(x, X_CELLS), shared_edges(v, _V_SHARES)
    if min(len(one) for one in edges) < 3 or not known[1].any():
        return None
    shape = len(edges[0]) - 1, len(edges[1]) - 1
    labels = _cells(x, v, edges)
    mean, drawn, samples, _ = means(np.where(labels >= 0, error, 0.0), labels, shape[0] * shape[1], blocks)
    filled = samples > 0
    with np.errstate(invalid="ignore"):
        spread = np.nanvar(np.where(np.isfinite(drawn), drawn, 0.0), axis=0)
    mean = np.where(filled, mean, 0.0)
    shrunk = mean * np.where(filled, mean**2 / np.maximum(mean**2 + spread, 1e-300), 0.0)
    offset = gaussian_filter(shrunk.reshape(shape), _SMOOTH, mode="nearest")
    e, at = judge[0], _cells(judge[1], judge[2], edges)
    corrected = np.where(at >= 0, e - offset.ravel()[at], e)
    one = np.where(known[1], 0, -1).astype(np.int64)
    before, before_drawn, _, _ = means(np.where(known[1], e**2, 0.0), one, 1, judge_blocks)
    after, after_drawn, _, _ = means(np.where(known[1], corrected**2, 0.0), one, 1, judge_blocks)
    return Correction(
        x_edges_m=edges[0],
        v_edges_m_s=edges[1],
        offset_m=offset,
        extended_rmse_m=float(np.sqrt(before[0])),
        corrected_rmse_m=float(np.sqrt(after[0])),
        ratio=estimate(float(np.sqrt(after[0] / before[0])), np.sqrt(after_drawn[:, 0] / before_drawn[:, 0])),
    )


def _cells(
    x: FloatArray, v: FloatArray, edges: tuple[FloatArray, FloatArray]
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    a, b = by_edges(x, edges[0]), by_edges(v, edges[1])
    return np.where((a >= 0) & (b >= 0), a * (len(edges[1]) - 1) + b, -1).astype(np.int64)
