"""A rig for the tests, written from the paper and `protocol/README.md` without anything of `twin`.

It integrates by 40 mid-point steps a tick, so that the twin's kernels are not their own judge; `gap_offset_m` puts the
coil plane above the top stop, which eq. (3) with x_max = travel cannot express.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from protocol.bus import board51_pb2 as pb

T_S = 2e-3
M, G, TRAVEL = 8.28e-3, 9.81, 5.7e-3
LQI = (0.49, 1700.0, 17.7, -17600.0)


@dataclass(kw_only=True)
class Rig:
    """A board with its plant; `run` yields a State per tick."""

    K_c: float = 2.7507e-6
    K_A: float = 0.297
    T_A: float = 3e-4
    b: float = 0.02
    gap_offset_m: float = 0.0
    sigma_x_m: float = 5e-6
    sigma_i_a: float = 2e-3
    process_a: float = 0.02
    process_i: float = 1e-4
    i_lsb: float = 4e-4
    x_lsb: float = 1.6e-6
    u_lsb: float = 1.25e-3
    gains: tuple[float, ...] = LQI
    x_0: float = 2.85e-3
    seed: int = 1
    session: int = 1
    tick: int = 0
    i: float = 0.0
    x: float = 0.0
    v: float = 0.0
    mode: int = pb.MODE_IDLE
    u_open: float = 0.0
    _s: float = 0.0
    _x_prev: float | None = None
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    @property
    def i_0(self) -> float:
        return math.sqrt(M * G / self.K_c) * (TRAVEL + self.gap_offset_m - self.x_0)

    def parameters(self, *, from_tick: int = 0) -> pb.Parameters:
        return pb.Parameters(
            session=self.session,
            sample_time_s=T_S,
            law=pb.LAW_LQI,
            gains=self.gains,
            i_0_a=self.i_0,
            x_0_m=self.x_0,
            u_0_v=self.i_0 / self.K_A,
            u_min_v=0.0,
            u_max_v=4095 * self.u_lsb,
            i_lsb_a=self.i_lsb,
            x_lsb_m=self.x_lsb,
            u_lsb_v=self.u_lsb,
            stream_divider=1,
            from_tick=from_tick,
        )

    def set_mode(self, mode: int) -> None:
        self.mode = mode
        self._s = 0.0
        self._x_prev = None

    def hold(self, x: float) -> None:
        """Put the ball at rest at x, carried, the board in closed loop with a matching integrator."""
        self.set_mode(pb.MODE_CLOSED_LOOP)
        self.x, self.v = x, 0.0
        self.i = math.sqrt(M * G / self.K_c) * (TRAVEL + self.gap_offset_m - x)
        u = self.i / self.K_A
        k_i, k_x, _, k_s = self.gains
        self._s = -(u - self.i_0 / self.K_A + k_i * (self.i - self.i_0) + k_x * (x - self.x_0)) / k_s

    def step(self, x_ref: float) -> pb.State:
        i_m = round((self.i + self.sigma_i_a * self._rng.normal()) / self.i_lsb) * self.i_lsb
        x_m = round((self.x + self.sigma_x_m * self._rng.normal()) / self.x_lsb) * self.x_lsb
        u = self._input(i_m, x_m, x_ref)
        state = pb.State(
            sequence=self.tick % 65536,
            tick=self.tick,
            session=self.session,
            host_time_ns=10**18 + self.tick * 2_000_000,
            i_c_a=i_m,
            x_m=x_m,
            u_c_v=u,
            x_ref_m=x_ref,
            mode=self.mode,  # type: ignore[arg-type]  # protobuf takes the number
            t_s=self.tick * T_S,
        )
        self._move(u)
        self.i += self.process_i * self._rng.normal()
        if 0.0 < self.x < TRAVEL:
            self.v += T_S * self.process_a * self._rng.normal()
        self.tick += 1
        return state

    def run(self, ticks: int, x_ref: float | Callable[[int], float]) -> Iterator[pb.State]:
        for _ in range(ticks):
            yield self.step(x_ref(self.tick) if callable(x_ref) else x_ref)

    def _input(self, i_m: float, x_m: float, x_ref: float) -> float:
        if self.mode == pb.MODE_IDLE:
            return 0.0
        if self.mode == pb.MODE_OPEN_LOOP:
            return self.u_open
        k1, k2, k3, k4 = self.gains
        previous = x_m if self._x_prev is None else self._x_prev
        u = self.i_0 / self.K_A - (
            k1 * (i_m - self.i_0) + k2 * (x_m - self.x_0) + k3 * (x_m - previous) / T_S + k4 * self._s
        )
        self._x_prev = x_m
        e = x_ref - x_m
        top = 4095 * self.u_lsb
        if not ((u > top and -k4 * e > 0) or (u < 0 and -k4 * e < 0)):
            self._s += e * T_S
        return round(min(max(u, 0.0), top) / self.u_lsb) * self.u_lsb

    def _move(self, u: float, steps: int = 40) -> None:
        h = T_S / steps
        keep = math.exp(-h / self.T_A)
        half = math.exp(-0.5 * h / self.T_A)
        for _ in range(steps):  # mid-point rule, second order
            i_mid = self.K_A * u + (self.i - self.K_A * u) * half
            self.i = self.K_A * u + (self.i - self.K_A * u) * keep
            x_mid = self.x + 0.5 * h * self.v
            gap = max(TRAVEL + self.gap_offset_m - x_mid, 0.01 * TRAVEL)
            force = self.K_c * i_mid**2 / gap**2 - M * G
            drag = self.b / M * h
            v_next = (self.v * (1 - 0.5 * drag) + h * force / M) / (1 + 0.5 * drag)
            self.x += 0.5 * h * (self.v + v_next)
            self.v = v_next
            if self.x <= 0.0:
                self.x, self.v = 0.0, max(self.v, 0.0)
            elif self.x >= TRAVEL:
                self.x, self.v = TRAVEL, min(self.v, 0.0)
