"""Controllers and their closed loops: linear, about the operating point, discrete with T_s.

    plant       p(k+1) = Phi p(k) + Gamma (u(k) + n_u) + w,   p = [i_c, x, x']
    controller  z(k+1) = A z(k) + B y(k),  u(k) = C z(k) + D y(k),   y = p + [n_i, n_x, 0]

Three controllers have the same K.  `ideal` has the true speed (the assumption of (17)); `backward` uses
(x - x_prev)/T_s (the board's law); `observer` uses a stationary Kalman filter of i_c and x.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from twin.mirror.monitor.expected import discrete_lyapunov

Gains = tuple[float, float, float, float]  # [k_i, k_x, k_v, k_int] of the law u = -K [i, x, x', s]


class Plant(NamedTuple):
    """The discrete plant (15)."""

    phi: NDArray[np.float64]  # (3, 3); more states with causes and delays, the first three as readings
    gamma: NDArray[np.float64]  # (3, 1)


class Controller(NamedTuple):
    """Linear law with the state z; shapes (n, n), (n, 3), (1, n), (1, 3)."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


class Noise(NamedTuple):
    """Variances per sample: of the sensors (A^2, m^2), of u (V^2), of process (A^2, m^2/s^2)."""

    i: float
    x: float
    u: float
    process_i: float
    process_v: float


def ideal(K: Gains, sample_time_s: float) -> Controller:
    """Return the state feedback with the true speed; z = [s]."""
    k_i, k_x, k_v, k_int = K
    return Controller(
        np.eye(1), np.array([[0.0, -sample_time_s, 0.0]]), np.array([[-k_int]]), np.array([[-k_i, -k_x, -k_v]])
    )


def backward(K: Gains, sample_time_s: float) -> Controller:
    """The board's law: speed = (x - x_prev)/T_s, u computed before s is advanced; z = [x_prev, s]."""
    k_i, k_x, k_v, k_int = K
    # (18) with the speed of the paper, (x(k) - x(k-1)) / T_s.
    k_d = k_v / sample_time_s
    return Controller(
        np.diag([0.0, 1.0]),
        np.array([[0.0, 1.0, 0.0], [0.0, -sample_time_s, 0.0]]),
        np.array([[k_d, -k_int]]),
        np.array([[-k_i, -k_x - k_d, 0.0]]),
    )


def kalman_gain(plant: Plant, noise: Noise) -> NDArray[np.float64]:
    """Return the stationary gain L of p(k|k) = p(k|k-1) + L (y - p(k|k-1)), shape (n, 2) for n states, from i_c and x.

    The Riccati equation is solved in units of the noise, because A^2 and um^2 differ too much for the solver.
    """
    phi, gamma = plant
    n = len(phi)
    scale = np.ones(n)
    pull = np.max(np.abs(phi[2, 1:]) * (np.arange(1, n) != 2))  # of a position on the speed, 1/s
    scale[:3] = np.sqrt(noise.i), np.sqrt(noise.x), np.sqrt(noise.x) * pull
    A = phi * scale[None, :] / scale[:, None]
    process = noise.u * gamma @ gamma.T
    process[0, 0] += noise.process_i
    process[2, 2] += noise.process_v
    H = np.eye(2, n)
    # The filter's equation is that of the regulator for the transposed system (R. E. Kalman, 1960).
    P = solve_discrete_are(A.T, H.T, process / np.outer(scale, scale), np.eye(2))
    # L = P H' inv(H P H' + R), with R = I in these units; solved, not inverted.
    gain = np.linalg.solve(H @ P @ H.T + np.eye(2), H @ P).T
    return np.asarray(gain * scale[:, None] / scale[None, :2])


def observer(K: Gains, plant: Plant, filter_gain: NDArray[np.float64], sample_time_s: float) -> Controller:
    """Build the LQG: K on the filtered state; z = [i_c, x, x' (and what follows them) predicted for this tick, s]."""
    phi, gamma = plant
    n = len(phi)
    K_p = np.zeros((1, n))
    # The gains act on the states that they are for; further states improve the prediction alone.
    K_p[0, :3] = K[:3]
    gain = np.zeros((n, n))  # of y = p: only i_c and x are measured
    gain[:, :2] = filter_gain
    read = np.hstack([-K_p @ (np.eye(n) - gain), [[-K[3]]]])
    direct = -K_p @ gain
    A, B = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n))
    A[:n, :n] = phi @ (np.eye(n) - gain)
    A[:n] += gamma @ read
    A[n, n] = 1.0
    B[:n] = phi @ gain + gamma @ direct
    B[n, 1] = -sample_time_s
    return Controller(A, B, read, direct)


def seeing(plant: Plant, controller: Controller) -> Controller:
    """The controller on a plant of more states (causes, delays); a law of three inputs uses the first three states."""
    n = len(plant.phi)
    if n == controller.B.shape[1]:
        return controller
    B, direct = np.zeros((len(controller.A), n)), np.zeros((1, n))
    B[:, :3], direct[:, :3] = controller.B[:, :3], controller.D[:, :3]
    return controller._replace(B=B, D=direct)


def closed_loop(plant: Plant, controller: Controller) -> NDArray[np.float64]:
    """Return F of [p, z](k+1) = F [p, z](k), shape (states of the plant + n,) * 2."""
    phi, gamma = plant
    A, B, read, direct = seeing(plant, controller)
    return np.block([[phi + gamma @ direct, gamma @ read], [B, A]])


def radius(plant: Plant, controller: Controller) -> float:
    """Return the largest |pole|; stable below 1; infinite if the plant has no equilibrium."""
    if not np.isfinite(plant.phi).all():
        return np.inf
    return float(np.max(np.abs(np.linalg.eigvals(closed_loop(plant, controller)))))


def noise_rms(plant: Plant, controller: Controller, noise: Noise) -> tuple[float, float]:
    """Return the stationary rms of x in m and of u_c in V: P = F P F' + G Q G'; infinite if the loop is unstable."""
    if radius(plant, controller) >= 1.0:
        return np.inf, np.inf
    gamma = plant.gamma
    _, B, read, direct = seeing(plant, controller)
    m, n = len(gamma), len(controller.A)
    G = np.zeros((m + n, 5))  # of [n_i, n_x, n_u, w_i, w_v]
    G[:m, :2], G[m:, :2] = gamma @ direct[:, :2], B[:, :2]
    G[:m, 2:3] = gamma
    G[0, 3] = G[2, 4] = 1.0
    P = discrete_lyapunov(closed_loop(plant, controller), G @ np.diag(noise) @ G.T)
    H = np.hstack([direct, read])
    through = np.array([direct[0, 0], direct[0, 1], 1.0, 0.0, 0.0])  # to u_c as the plant gets it, rounded
    return float(np.sqrt(P[1, 1])), float(np.sqrt((H @ P @ H.T)[0, 0] + through**2 @ np.array(noise)))
