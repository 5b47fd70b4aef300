"""Prediction errors of an extended Kalman filter along a whole campaign: the criterion of the fit.

State [i_c, x, x'] of (9)-(12), measured i_c and x, white noise on both, white disturbance of current and acceleration
within each interval.  The filter sees what a board sees: u_c held from sample to sample.

Rule 1: every sample says by its flags what holds for it: FOLLOWS (the one before is one interval away), FLIES (the ball
        is free of the stops), USE_I, USE_X.  A ball that does not fly leaves a filter of i_c alone.
Rule 2: a flight starts at its first x with an unknown speed: initial states are estimated, never assumed.
Rule 3: derivatives are differences of this very kernel: there is no second set of equations to be wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.estimation.record import FloatArray
from twin.estimation.structures import NoiseLevels
from twin.estimation.transition import Physics, moments, transit

FOLLOWS, FLIES, USE_I, USE_X = 1, 2, 4, 8
RESTS_LOW, RESTS_HIGH, RESTS_UNSEEN, LOST = 16, 32, 64, 128
SPEED_STD_M_S = 0.5  # of a ball whose speed nobody has seen yet


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Samples in order, ready for the filter; all of shape (n,).  Made by `prepare.py`."""

    step: FloatArray  # s, to the sample before
    u: FloatArray  # V, from this sample on
    i: FloatArray  # A
    x: FloatArray  # m
    flags: NDArray[np.uint8]
    recording: NDArray[np.int32]  # index of the recording

    def part(self, piece: slice) -> Series:
        """Some of the samples, as views."""
        return Series(
            step=self.step[piece],
            u=self.u[piece],
            i=self.i[piece],
            x=self.x[piece],
            flags=self.flags[piece],
            recording=self.recording[piece],
        )

    def __len__(self) -> int:
        return len(self.u)


@kernel
def run_filter(
    physics: Packed,
    noise: NoiseLevels,
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    y_i: NDArray[np.float64],
    y_x: NDArray[np.float64],
    flags: NDArray[np.uint8],
    out: NDArray[np.float64],
    state: NDArray[np.float64],
) -> None:
    """Fill out, shape (n, 5), with innovations and their covariance, and `state` with the corrected estimates.

    Args:
        physics: tuple(Physics).
        noise: of readings and motion.
        step: time to the sample before, s, shape (n,).
        u: u_c from each sample on, V, shape (n,).
        y_i: measured i_c, A, shape (n,).
        y_x: measured x, m, shape (n,).
        flags: of each sample, shape (n,).
        out: receives nu_i, nu_x, S_ii, S_ix, S_xx.
        state: receives i_c, x, x' after the correction, shape (n, 3), NaN where the ball does not fly; shape (0, 3)
            where nobody wants them.
    """
    p = Physics(*physics)
    r_i, r_x, a2 = noise.sigma_i_c_a**2, noise.sigma_x_m**2, noise.process_a_m_s2**2
    q_per_s = noise.process_i_c_a**2 / noise.tick_s
    m = np.empty(9)
    at = -1.0
    i, x, v = 0.0, 0.0, 0.0
    p_ii, p_ix, p_iv, p_xx, p_xv, p_vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    in_flight = False
    for n in range(len(u)):
        flag = flags[n]
        for column in range(5):
            out[n, column] = np.nan
        follows = flag & FOLLOWS != 0 and n > 0
        flies = flag & FLIES != 0
        if follows:
            T_s = step[n]
            if T_s != at:
                moments(T_s, p.T_A, m)
                at = T_s
            w = u[n - 1]
            q_i = q_per_s * T_s
            if in_flight and flies:
                # Differences at the scale of the state: relative error 1e-7, no cancellation of 1e-16.
                i_0, x_0, v_0 = transit(p, m, T_s, i, x, v, w)
                h_i, h_x, h_v = 1e-5 * (abs(i) + 1e-3), 1e-6 * p.x_max_m, 1e-5
                _, x_i, v_i = transit(p, m, T_s, i + h_i, x, v, w)
                _, x_x, v_x = transit(p, m, T_s, i, x + h_x, v, w)
                _, x_v, v_v = transit(p, m, T_s, i, x, v + h_v, w)
                f_ii = m[8]
                f_xi, f_xx, f_xv = (x_i - x_0) / h_i, (x_x - x_0) / h_x, (x_v - x_0) / h_v
                f_vi, f_vx, f_vv = (v_i - v_0) / h_i, (v_x - v_0) / h_x, (v_v - v_0) / h_v
                i, x, v = i_0, x_0, v_0
                g_ii, g_ix, g_iv = f_ii * p_ii, f_ii * p_ix, f_ii * p_iv
                g_xi = f_xi * p_ii + f_xx * p_ix + f_xv * p_iv
                g_xx = f_xi * p_ix + f_xx * p_xx + f_xv * p_xv
                g_xv = f_xi * p_iv + f_xx * p_xv + f_xv * p_vv
                g_vi = f_vi * p_ii + f_vx * p_ix + f_vv * p_iv
                g_vx = f_vi * p_ix + f_vx * p_xx + f_vv * p_xv
                g_vv = f_vi * p_iv + f_vx * p_xv + f_vv * p_vv
                p_ix = g_ii * f_xi + g_ix * f_xx + g_iv * f_xv
                p_iv = g_ii * f_vi + g_ix * f_vx + g_iv * f_vv
                p_ii = g_ii * f_ii + q_i
                p_xx = g_xi * f_xi + g_xx * f_xx + g_xv * f_xv + 0.25 * a2 * T_s**4
                p_xv = g_xi * f_vi + g_xx * f_vx + g_xv * f_vv + 0.5 * a2 * T_s**3
                p_vv = g_vi * f_vi + g_vx * f_vx + g_vv * f_vv + a2 * T_s**2
            else:
                e = p.K_A * w
                i = e + (i - e) * m[8]
                p_ii = m[8] * m[8] * p_ii + q_i
                in_flight = False
        else:
            in_flight = False

        use_i = flag & USE_I != 0
        use_x = flag & USE_X != 0
        if not follows:
            if use_i:
                i, p_ii = y_i[n], r_i
            else:
                i, p_ii = p.K_A * u[n], 1e2
            use_i = False
        if flies and not in_flight:
            if use_x:
                x, v, in_flight = y_x[n], 0.0, True
                p_xx, p_xv, p_vv, p_ix, p_iv = r_x, 0.0, SPEED_STD_M_S**2, 0.0, 0.0
            use_x = False
        use_x = use_x and in_flight

        if use_i and use_x:
            s_ii, s_ix, s_xx = p_ii + r_i, p_ix, p_xx + r_x
            n_i, n_x = y_i[n] - i, y_x[n] - x
            out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4] = n_i, n_x, s_ii, s_ix, s_xx
            det = s_ii * s_xx - s_ix * s_ix
            k_ii, k_ix = (p_ii * s_xx - p_ix * s_ix) / det, (p_ix * s_ii - p_ii * s_ix) / det
            k_xi, k_xx = (p_ix * s_xx - p_xx * s_ix) / det, (p_xx * s_ii - p_ix * s_ix) / det
            k_vi, k_vx = (p_iv * s_xx - p_xv * s_ix) / det, (p_xv * s_ii - p_iv * s_ix) / det
            i += k_ii * n_i + k_ix * n_x
            x += k_xi * n_i + k_xx * n_x
            v += k_vi * n_i + k_vx * n_x
            p_vv -= k_vi * p_iv + k_vx * p_xv
            p_xv -= k_xi * p_iv + k_xx * p_xv
            p_iv -= k_ii * p_iv + k_ix * p_xv
            p_xx -= k_xi * p_ix + k_xx * p_xx
            before_ii, before_ix = p_ii, p_ix
            p_ii -= k_ii * before_ii + k_ix * before_ix
            p_ix = before_ix - k_xi * before_ii - k_xx * before_ix
        elif use_i:
            s_ii, n_i = p_ii + r_i, y_i[n] - i
            out[n, 0], out[n, 2] = n_i, s_ii
            gain = p_ii / s_ii
            i += gain * n_i
            if in_flight:
                k_x, k_v = p_ix / s_ii, p_iv / s_ii
                x += k_x * n_i
                v += k_v * n_i
                p_xx -= k_x * p_ix
                p_xv -= k_x * p_iv
                p_vv -= k_v * p_iv
                p_ix -= gain * p_ix
                p_iv -= gain * p_iv
            p_ii -= gain * p_ii
        elif use_x:
            s_xx, n_x = p_xx + r_x, y_x[n] - x
            out[n, 1], out[n, 4] = n_x, s_xx
            k_i, k_x, k_v = p_ix / s_xx, p_xx / s_xx, p_xv / s_xx
            i += k_i * n_x
            x += k_x * n_x
            v += k_v * n_x
            p_ii -= k_i * p_ix
            p_iv -= k_i * p_xv
            p_ix -= k_i * p_xx
            p_vv -= k_v * p_xv
            p_xv -= k_x * p_xv
            p_xx -= k_x * p_xx
        if state.shape[0] > 0:
            state[n, 0] = i if in_flight else np.nan
            state[n, 1] = x if in_flight else np.nan
            state[n, 2] = v if in_flight else np.nan


@kernel
def whiten(out: NDArray[np.float64], loglik: NDArray[np.float64], white: NDArray[np.float64]) -> float:
    """Per-sample log-likelihood (without constants) and whitened innovations (i_c, then x given i_c); the sum.

    NaN innovations give 0 and NaN.  -inf where a covariance is not positive: the parameters are impossible.
    """
    total = 0.0
    for n in range(out.shape[0]):
        n_i, n_x, s_ii, s_ix, s_xx = out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4]
        value = 0.0
        white[n, 0], white[n, 1] = np.nan, np.nan
        has_i, has_x = s_ii == s_ii, s_xx == s_xx
        if has_i:
            if not s_ii > 0.0:
                return -np.inf
            white[n, 0] = n_i / math.sqrt(s_ii)
            value -= 0.5 * (math.log(s_ii) + white[n, 0] ** 2)
        if has_x:
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


@kernel
def information(
    base: NDArray[np.float64],
    moved: NDArray[np.float64],
    scores: NDArray[np.float64],
    fisher: NDArray[np.float64],
) -> None:
    """Score per sample and Fisher information, from the filter's output and its derivatives.

    With w the whitened innovations and dw, dS their derivatives in the whitened frame,
        score_a = 1/2 (w' dS_a w - tr dS_a) - w' dnu_a,   F_ab = dnu_a' dnu_b + 1/2 tr(dS_a dS_b).

    Args:
        base: output of the filter, shape (n, 5).
        moved: d output / d parameter, shape (n_parameters, n, 5).
        scores: receives the score of each sample, shape (n, n_parameters).
        fisher: is added to, shape (n_parameters, n_parameters).
    """
    count = moved.shape[0]
    row = np.empty((count, 5))  # dnu_1, dnu_2, dS_11, sqrt(2) dS_12, dS_22, the last three over sqrt(2)
    half = math.sqrt(0.5)
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
        w_1 = base[n, 0] / l_11 if has_i else 0.0
        w_2 = (base[n, 1] - l_21 * w_1) / l_22 if has_x else 0.0
        for a in range(count):
            d_1 = moved[a, n, 0] / l_11 if has_i else 0.0
            d_2 = (moved[a, n, 1] - l_21 * d_1) / l_22 if has_x else 0.0
            e_11 = moved[a, n, 2] / (l_11 * l_11) if has_i else 0.0
            e_12 = (moved[a, n, 3] / l_11 - l_21 * e_11) / l_22 if has_i and has_x else 0.0
            e_22 = 0.0
            if has_x:
                cross = moved[a, n, 3] / l_11 if has_i else 0.0
                e_22 = (moved[a, n, 4] - 2.0 * l_21 * cross + l_21 * l_21 * e_11) / (l_22 * l_22)
            row[a, 0], row[a, 1] = d_1, d_2
            row[a, 2], row[a, 3], row[a, 4] = half * e_11, e_12, half * e_22
            scores[n, a] = (
                0.5 * (w_1 * e_11 * w_1 + 2.0 * w_1 * e_12 * w_2 + w_2 * e_22 * w_2 - e_11 - e_22)
                - w_1 * d_1
                - w_2 * d_2
            )
        for a in range(count):
            for b in range(a + 1):
                total = 0.0
                for column in range(5):
                    total += row[a, column] * row[b, column]
                fisher[a, b] += total
                if b != a:
                    fisher[b, a] += total
