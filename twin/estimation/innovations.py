"""Innovations of a campaign: flags of the samples, log-likelihood, score and Fisher information.

A sample has flags.  FOLLOWS: the previous sample is one interval earlier.  FLIES: the ball is free of the stops, else
only i_c is filtered.  USE_I, USE_X: the reading is used.  CAPTURED: the sample belongs to a capture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.compiled import kernel
from twin.estimation.record import BoolArray, FloatArray
from twin.estimation.structures import Samples

FOLLOWS, FLIES, USE_I, USE_X = 1, 2, 4, 8
RESTS_LOW, RESTS_HIGH, RESTS_UNSEEN, LOST = 16, 32, 64, 128
CAPTURED = 256
SPEED_STD_M_S = 0.5  # initial standard deviation of the speed


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Samples in order, ready for the filter; all of shape (n,).  Made by `prepare.py`."""

    step: FloatArray  # s, since the previous sample
    u: FloatArray  # V, from this sample on
    i: FloatArray  # A
    x: FloatArray  # m
    flags: NDArray[np.uint16]
    recording: NDArray[np.int32]  # index of the recording

    def part(self, piece: slice | BoolArray) -> Series:
        """A part of the samples; of a slice, as views."""
        return Series(**{name: getattr(self, name)[piece] for name in Series.__slots__})

    @staticmethod
    def joined(parts: Sequence[Series]) -> Series:
        """The samples of all parts, one after the other; none without parts."""
        none: dict[str, Any] = {"flags": np.empty(0, np.uint16), "recording": np.empty(0, np.int32)}
        return Series(
            **{
                name: np.concatenate([none.get(name, np.empty(0)), *(getattr(part, name) for part in parts)])
                for name in Series.__slots__
            }
        )

    @property
    def samples(self) -> Samples:
        """The samples in the form of the filter, with the time summed along the series."""
        return Samples(np.cumsum(self.step), self.step, self.u, self.i, self.x, self.flags)

    def __len__(self) -> int:
        return len(self.u)


@kernel
def whiten(out: NDArray[np.float64], loglik: NDArray[np.float64], white: NDArray[np.float64]) -> float:
    """Compute log-likelihood and whitened innovations of each sample; return its total, without constants.

    (S 2) of docs/theory/statistics.md (F. Schweppe, 1965), whitened by the Cholesky factor of S, i_c first.

    Args:
        out: output of the filter, shape (n, 5).
        loglik: receives the log-likelihood of each sample, shape (n,); 0 for NaN innovations.
        white: receives the whitened innovations of i_c, and of x given i_c, shape (n, 2).

    Returns:
        The sum; -inf if a covariance is not positive, that is, for impossible parameters.
    """
    total = 0.0
    for n in range(out.shape[0]):
        n_i, n_x, s_ii, s_ix, s_xx = out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4]
        value = 0.0
        white[n, 0], white[n, 1] = np.nan, np.nan
        has_i, has_x = s_ii == s_ii, s_xx == s_xx
        if has_i:
            # Not an exception: a climb may try impossible parameters, and turns back at -inf.
            if not s_ii > 0.0:
                return -np.inf
            white[n, 0] = n_i / math.sqrt(s_ii)
            value -= 0.5 * (math.log(s_ii) + white[n, 0] ** 2)
        if has_x:
            # The order does not change the sum. With i_c first, x counts only for what i_c does not tell already.
            if has_i:
                n_x -= s_ix / s_ii * n_i
                s_xx -= s_ix * s_ix / s_ii
            if not s_xx > 0.0:
                return -np.inf
            white[n, 1] = n_x / math.sqrt(s_xx)
            value -= 0.5 * (math.log(s_xx) + white[n, 1] ** 2)
        loglik[n] = value
        total += value
    return total if math.isfinite(total) else -np.inf


def whitened(out: NDArray[np.float64]) -> NDArray[np.float64]:
    """The whitened innovations of `whiten`, shape (n, 2); NaN without a prediction."""
    white = np.full((len(out), 2), np.nan)  # for impossible parameters `whiten` stops early
    whiten(out, np.empty(len(out)), white)
    return white


@kernel
def information(
    base: NDArray[np.float64],
    moved: NDArray[np.float64],
    scores: NDArray[np.float64],
    fisher: NDArray[np.float64],
) -> None:
    """Compute score per sample and Fisher information, (S 3), from the filter's output and its derivatives.

    With w the whitened innovations and dw, dS their derivatives in the whitened frame,
        score_a = 1/2 (w' dS_a w - tr dS_a) - w' dnu_a,   F_ab = dnu_a' dnu_b + 1/2 tr(dS_a dS_b).

    Args:
        base: output of the filter, shape (n, 5).
        moved: d output / d parameter, shape (n_parameters, n, 5).
        scores: receives the score of each sample, shape (n, n_parameters).
        fisher: the information is added to this matrix, shape (n_parameters, n_parameters).
    """
    count = moved.shape[0]
    rows = np.empty((5, count))  # dnu_1, dnu_2, dS_11, sqrt(2) dS_12, dS_22, the last three over sqrt(2)
    added, half = np.zeros((count, count)), math.sqrt(0.5)
    for n in range(base.shape[0]):
        has_i, has_x = base[n, 2] == base[n, 2], base[n, 4] == base[n, 4]
        if not (has_i or has_x):
            for a in range(count):
                scores[n, a] = 0.0
            continue
        # Lower triangular factor L of S and its inverse; absent channels get unit variance and no derivative.
        l_11 = math.sqrt(base[n, 2]) if has_i else 1.0
        l_21 = base[n, 3] / l_11 if has_i and has_x else 0.0
        l_22 = math.sqrt(base[n, 4] - l_21 * l_21) if has_x else 1.0
        k_11, k_22 = 1.0 / l_11, 1.0 / l_22
        w_1 = base[n, 0] * k_11 if has_i else 0.0
        w_2 = (base[n, 1] - l_21 * w_1) * k_22 if has_x else 0.0
        for a in range(count):
            d_1 = moved[a, n, 0] * k_11 if has_i else 0.0
            d_2 = (moved[a, n, 1] - l_21 * d_1) * k_22 if has_x else 0.0
            e_11 = moved[a, n, 2] * k_11 * k_11 if has_i else 0.0
            cross = moved[a, n, 3] * k_11 if has_i and has_x else 0.0
            e_12 = (cross - l_21 * e_11) * k_22 if has_x else 0.0
            e_22 = (moved[a, n, 4] - l_21 * (2.0 * cross - l_21 * e_11)) * k_22 * k_22 if has_x else 0.0
            rows[0, a], rows[1, a], rows[2, a], rows[3, a], rows[4, a] = d_1, d_2, half * e_11, e_12, half * e_22
            scores[n, a] = (
                0.5 * (w_1 * e_11 * w_1 + 2.0 * w_1 * e_12 * w_2 + w_2 * e_22 * w_2 - e_11 - e_22)
                - w_1 * d_1
                - w_2 * d_2
            )
        # The innermost loop runs along rows, so the compiler takes several of its steps at once.
        for a in range(count):
            r_0, r_1, r_2, r_3, r_4 = rows[0, a], rows[1, a], rows[2, a], rows[3, a], rows[4, a]
            for b in range(a + 1):
                added[a, b] += (
                    r_0 * rows[0, b] + r_1 * rows[1, b] + r_2 * rows[2, b] + r_3 * rows[3, b] + r_4 * rows[4, b]
                )
    for a in range(count):
        for b in range(a + 1):
            fisher[a, b] += added[a, b]
            if b != a:
                fisher[b, a] += added[a, b]
