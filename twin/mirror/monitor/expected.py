"""The effect of noise alone on measured minus twin: its standard deviation, and the tail of a window mean.

The free twin has no noise; the rig's loop has: sensor noise enters the law, moves the ball and comes back.  So even a
right model differs from the rig by a coloured error, larger than the sensor noise.  With rig and twin linearised
around the same position their difference obeys the closed loop itself, driven by the noise w alone:

    d(k+1) = F d(k) + G w(k),   error(k) = H d(k) + D w(k),   d = [i_c, x, x', integral, previous measured x]

Rule: where F is not stable there is no stationary error, hence no expectation: None.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.special import ndtr

from twin.control import LawNumbers, discrete
from twin.model.parameters import Model
from twin.settings.mirror import EDGE_SHARE, OFF_PROBABILITY, POSITIONS, STABLE


class Expectation(NamedTuple):
    """The expected measured - twin under a right model, around one reference."""

    std: tuple[float, float, float]  # of x (m), i_c (A), u_c (V)
    on: tuple[float, float]  # the window mean of (error / std)^2 of x, i_c exceeds this with the alarm's probability
    off: tuple[float, float]  # and this with OFF_PROBABILITY


class ExpectedError:
    """Moments of measured - twin of (x, i_c, u_c) in closed loop, by the position of the reference.

    Args:
        model: assumed right.
        law: of the board.
        i_lsb_a, x_lsb_m, u_lsb_v: one count of each converter; 0 where unknown.
        window: ticks of the window whose mean is judged.
        probability: of a false alarm per window.
    """

    def __init__(
        self,
        model: Model,
        law: LawNumbers,
        *,
        i_lsb_a: float,
        x_lsb_m: float,
        u_lsb_v: float,
        window: int,
        probability: float,
    ) -> None:
        travel = model.plant.travel_m
        self._grid = np.linspace(EDGE_SHARE * travel, (1.0 - EDGE_SHARE) * travel, POSITIONS).tolist()
        self._window = window
        self._probability = probability
        noise = model.noise
        variances = np.array(
            [
                noise.sigma_i_c_a**2 + i_lsb_a**2 / 12.0,
                noise.sigma_x_m**2 + x_lsb_m**2 / 12.0,
                u_lsb_v**2 / 12.0,
                noise.process_i_c_a**2,
                # An acceleration that is constant over a tick changes the speed by a T_s.
                (noise.process_a_m_s2 * law.sample_time_s) ** 2,
            ]
        )
        self._variances = variances
        self._loops = [error_dynamics(model, law, float(x)) for x in self._grid]
        # Where the model's ball cannot rest at all there is nothing to linearise, and no expectation.
        self._radius = [
            float(np.max(np.abs(np.linalg.eigvals(F)))) if np.isfinite(F).all() else np.inf
            for F, _, _, _ in self._loops
        ]
        self._std: list[list[float]] = [
            np.sqrt(autocovariance(*loop, variances, lags=1)[0]).tolist() if radius < STABLE else []
            for loop, radius in zip(self._loops, self._radius, strict=True)
        ]
        self._quantiles: dict[tuple[int, int], tuple[float, float]] = {}

    def at(self, x_ref: float) -> Expectation | None:
        """Return the expectation around `x_ref` (m), interpolated; None where the model's loop is unstable."""
        cell, share = self._cell(x_ref)
        if not self._stable(cell):
            return None
        low, high = self._std[cell], self._std[cell + 1]
        tails = [(self._quantile(cell, k), self._quantile(cell + 1, k)) for k in range(2)]
        return Expectation(
            std=(
                low[0] + share * (high[0] - low[0]),
                low[1] + share * (high[1] - low[1]),
                low[2] + share * (high[2] - low[2]),
            ),
            # The larger quantile of the two neighbours, not one between them: in doubt, fewer false alarms.
            on=(max(tails[0][0][0], tails[0][1][0]), max(tails[1][0][0], tails[1][1][0])),
            off=(max(tails[0][0][1], tails[0][1][1]), max(tails[1][0][1], tails[1][1][1])),
        )

    def settle_ticks(self, x_ref: float, *, share: float) -> int | None:
        """Return the ticks until an initial difference shrinks to `share` of itself; None if the loop is unstable."""
        cell, _ = self._cell(x_ref)
        if not self._stable(cell):
            return None
        # By the slowest pole on either side of the reference: the others have decayed before it.
        return math.ceil(math.log(share) / math.log(max(self._radius[cell : cell + 2])))

    def _stable(self, cell: int) -> bool:
        return self._radius[cell] < STABLE and self._radius[cell + 1] < STABLE

    def _cell(self, x_ref: float) -> tuple[int, float]:
        position = (x_ref - self._grid[0]) / (self._grid[1] - self._grid[0])
        position = min(max(position, 0.0), POSITIONS - 1.0)
        cell = min(int(position), POSITIONS - 2)
        return cell, position - cell

    def _quantile(self, point: int, signal: int) -> tuple[float, float]:
        # On demand: 10 ms each for a window of 500, and a rig visits few of the positions.
        if (point, signal) not in self._quantiles:
            covariance = autocovariance(*self._loops[point], self._variances, lags=self._window)[:, signal]
            # A covariance has no negative eigenvalues: those just below 0 are rounding errors.
            weights = np.maximum(toeplitz_eigenvalues(covariance / covariance[0]), 0.0) / self._window
            self._quantiles[point, signal] = (
                weighted_chi_square_quantile(weights, self._probability),
                weighted_chi_square_quantile(weights, OFF_PROBABILITY),
            )
        return self._quantiles[point, signal]


def error_dynamics(
    model: Model, law: LawNumbers, x_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return (F, G, H, D) of the difference between a noisy and a noise-free loop around `x_m`.

    State d = [p, s, x_prev] with p the n states of `control.discrete`, first of them the readings of i_c, x and x';
    noise w = [n_i, n_x, n_u, w_i, w_v]; outputs [x, i_c, u_c] as measured.
    Shapes (n + 2, n + 2), (n + 2, 5), (3, n + 2), (3, 5).
    """
    A, B = discrete(model, x_m, law.sample_time_s)
    n = len(A)
    on_x = -(law.k_x + law.k_p) - law.k_v / law.sample_time_s
    from_state = np.zeros(n + 2)  # u_c of rule 9
    from_state[0], from_state[1] = -law.k_i, on_x
    from_state[n], from_state[n + 1] = law.k_s, law.k_v / law.sample_time_s
    from_noise = np.array([-law.k_i, on_x, 1.0, 0.0, 0.0])
    F, G = np.zeros((n + 2, n + 2)), np.zeros((n + 2, 5))
    F[:n, :n] = A
    F[:n] += B @ from_state[None, :]
    F[n, 1], F[n, n] = -law.sample_time_s, 1.0
    F[n + 1, 1] = 1.0
    G[:n] = B @ from_noise[None, :]
    G[0, 3], G[2, 4] = 1.0, 1.0
    G[n, 1] = -law.sample_time_s
    G[n + 1, 1] = 1.0
    sensors = np.zeros((2, n + 2))
    sensors[0, 1] = sensors[1, 0] = 1.0
    noise = np.array([[0.0, 1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0]])
    return F, G, np.vstack([sensors, from_state]), np.vstack([noise, from_noise])


def autocovariance(
    F: NDArray[np.float64],
    G: NDArray[np.float64],
    H: NDArray[np.float64],
    through: NDArray[np.float64],  # D
    variances: NDArray[np.float64],
    *,
    lags: int,
) -> NDArray[np.float64]:
    """Return the stationary autocovariance of each output at lags 0 .. lags-1, shape (lags, outputs); F must be stable.

    P = F P F' + G Q G' (discrete Lyapunov); R(0) = H P H' + D Q D'; R(k) = H F^(k-1) (F P H' + G Q D').
    """
    Q = np.diag(variances)
    P = discrete_lyapunov(F, G @ Q @ G.T)
    result = np.empty((lags, H.shape[0]))
    result[0] = np.diag(H @ P @ H.T + through @ Q @ through.T)
    carried = F @ P @ H.T + G @ Q @ through.T
    for lag in range(1, lags):
        # Each output with itself alone: an alarm judges one signal.
        result[lag] = np.einsum("os,so->o", H, carried)
        carried = F @ carried
    return result


def discrete_lyapunov(F: NDArray[np.float64], Q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve P = F P F' + Q for stable F, all of shape (n, n).

    P is the sum of F^k Q F'^k, whose number of terms is doubled at each step (R. A. Smith, 1968).  scipy's direct
    solver loses half its digits here: amperes and micrometres share a matrix.  Every term of the sum is positive
    semidefinite, so nothing cancels.
    """
    P, power = Q, F
    # 2^60 terms; the slowest loop that counts as stable takes some 2^34.
    for _ in range(60):
        more = power @ P @ power.T
        P = P + more
        if np.max(np.diag(more) - 1e-15 * np.diag(P)) <= 0.0:
            break
        power = power @ power
    return P


def toeplitz_eigenvalues(column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the eigenvalues of the symmetric Toeplitz matrix with this first column, shape (n,).

    For even n the matrix is [[A, C'], [C, JAJ]] with J the exchange matrix.  So its eigenvalues are those of A + JC and
    A - JC, for a quarter of the work (Cantoni and Butler, Linear Algebra Appl. 13, 1976).
    """
    n = len(column)
    if n % 2:
        return np.asarray(np.linalg.eigvalsh(toeplitz(column)))
    half = toeplitz(column[: n // 2])
    flipped = toeplitz(column[n // 2 :], column[n // 2 : 0 : -1])[::-1]
    return np.concatenate([np.linalg.eigvalsh(half + flipped), np.linalg.eigvalsh(half - flipped)])


def weighted_chi_square_quantile(weights: NDArray[np.float64], probability: float) -> float:
    """Return q with P(sum of weights_j * chi-square_1 > q) = probability.

    The tail is the saddlepoint formula of Lugannani and Rice (1980), within a few percent of the probability for any
    weights.  A chi-square of equal mean and variance (Satterthwaite, 1946) is too low in the far tail if few weights
    dominate.  A slow loop under a 1 s window is such a case.

    Args:
        weights: non-negative, shape (n,): eigenvalues of the covariance of what is squared and summed.
        probability: of the tail, 0 < probability <= 0.1.
    """

    def tail(s: float) -> float:
        shrunk = 1.0 - 2.0 * s * weights
        cumulant = -0.5 * float(np.sum(np.log(shrunk)))
        slope = float(np.sum(weights / shrunk))
        curvature = 2.0 * float(np.sum((weights / shrunk) ** 2))
        w = math.sqrt(2.0 * (s * slope - cumulant))
        v = s * math.sqrt(curvature)
        density = math.exp(-0.5 * w * w) / math.sqrt(2.0 * math.pi)
        return float(ndtr(-w)) + density * (1.0 / v - 1.0 / w)

    # The cumulants exist below 1 / (2 max weight), and at s = 0 the formula is infinity less infinity.
    low, high = 1e-3 / weights.max() * 0.5, (1.0 - 1e-9) / weights.max() * 0.5
    for _ in range(80):
        # Bisection: the tail falls steadily with s, and its derivative is not at hand.
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tail(middle) > probability else (low, middle)
    return float(np.sum(weights / (1.0 - 2.0 * low * weights)))
