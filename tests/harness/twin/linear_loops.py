"""Linear loops of known truth, many flights at once: the paper's (14) written out, exact holds, an LQI, white noise.

Nothing of the twin computes anything here.  Deviations from the equilibrium; a signal has the shape (flights, n).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from twin.control import LawNumbers

Array = NDArray[np.float64]
TICK_S = 2e-3
LAW = LawNumbers(
    u_0=2.0, i_0=0.6, x_0=2.85e-3, k_i=0.49, k_x=1700.0, k_p=0.0, k_v=17.7, k_s=17600.0, u_low=-math.inf,
    u_high=math.inf, s_max=math.inf, sample_time_s=TICK_S,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Loop:
    """The truth of one rig around one height; SI units."""

    K_A: float = 0.297
    T_A: float = 3e-4
    K_c: float = 5.607e-6
    b: float = 0.02
    m: float = 8.28e-3
    gap: float = 5.2877e-3  # x_max - x
    delay_s: float = 0.0  # of u_c, below one tick
    lag_s: float = 0.0  # of the position sensor
    noise: Mapping[str, float] = field(default_factory=lambda: {"i": 2e-3, "x": 5e-6, "u": 4e-4, "v": 4e-5})

    def discrete(self) -> tuple[Array, Array, Array]:
        """Phi, and Gamma of u(k) and of u(k-1), for [i, x, x', reading of x]."""
        i = self.gap * math.sqrt(self.m * 9.81 / self.K_c)
        stiffness = 2.0 * self.K_c * i * i / self.gap**3 / self.m
        pull = 2.0 * self.K_c * i / self.gap**2 / self.m
        A = np.zeros((4, 4))
        A[0, 0] = -1.0 / self.T_A
        A[1, 2] = 1.0
        A[2] = [pull, stiffness, -self.b / self.m, 0.0]
        if self.lag_s:
            A[3, 1], A[3, 3] = 1.0 / self.lag_s, -1.0 / self.lag_s
        B = np.array([[self.K_A / self.T_A], [0.0], [0.0], [0.0]])
        phi, new = held(A, B, TICK_S - self.delay_s)
        before, old = held(A, B, self.delay_s)
        return phi @ before, new, phi @ old

    def response(self, f_hz: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The true i_c / u_c and x / u_c."""
        phi, new, old = self.discrete()
        z = np.exp(2j * np.pi * f_hz * TICK_S)
        both = np.stack([np.linalg.solve(point * np.eye(4) - phi, new + old / point)[:, 0] for point in z], axis=1)
        return both[0], both[3 if self.lag_s else 1]

    def fly(self, r: Array, *, flights: int, seed: int) -> Array:
        """Return r, u_c, i_c, x as recorded, shape (flights, 4, n)."""
        rng = np.random.default_rng(seed)
        phi, new, old = self.discrete()
        state, u_before = np.zeros((4, flights)), np.zeros(flights)
        s, x_before = np.zeros(flights), np.zeros(flights)
        sizes = np.array([self.noise[name] for name in ("i", "x", "u", "v")])
        out = np.empty((flights, 4, len(r)))
        for k, r_k in enumerate(r):
            n = sizes[:, None] * rng.standard_normal((4, flights))
            i, x = state[0] + n[0], state[3 if self.lag_s else 1] + n[1]
            u = -LAW.k_i * i - LAW.k_x * x - LAW.k_v * (x - x_before) / TICK_S + LAW.k_s * s + n[2]
            out[:, 0, k], out[:, 1, k], out[:, 2, k], out[:, 3, k] = r_k, u, i, x
            s, x_before = s + (r_k - x) * TICK_S, x
            state = phi @ state + new @ u[None] + old @ u_before[None]
            state[2] += n[3]
            u_before = u
        return out


def held(A: Array, B: Array, time_s: float) -> tuple[Array, Array]:
    """The zero-order hold over a time."""
    whole = expm(np.block([[A, B], [np.zeros((1, len(A) + 1))]]) * time_s)
    return whole[: len(A), : len(A)], whole[: len(A), len(A) :]


def multisine(n: int, *, period: int, amplitude: float) -> Array:
    """Eight harmonics with Schroeder phases; zero for the first sample."""
    t = np.arange(n) / period
    waves = [np.sin(2 * np.pi * (h * t - h * (h - 1) / 16)) for h in range(1, 9)]
    return np.asarray(amplitude / 3.0 * np.sum(waves, axis=0))


def chirp(n: int, *, from_hz: float, to_hz: float, amplitude: float) -> Array:
    """A sine whose frequency rises linearly."""
    t = np.arange(n) * TICK_S
    return np.asarray(amplitude * np.sin(2 * np.pi * (from_hz * t + 0.5 * (to_hz - from_hz) / t[-1] * t * t)))
