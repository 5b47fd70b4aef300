"""A ball on a coil written from the paper's equations alone: nothing of the emulator, nothing of the twin.

Velocity Verlet in 1/50 of a tick with the amplifier's exact decay, an elastic-plastic stop, its own LQI, its own noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protocol.campaign import Campaign, Kind, parse
from twin.estimation.record import Record

SUBSTEPS = 50


@dataclass(frozen=True, kw_only=True)
class Ball:
    """Truth of one rig; SI units."""

    K_A: float = 0.3
    T_A: float = 8e-4
    K_c: float = 3.1e-6
    b: float = 0.03
    m: float = 8.5e-3
    g: float = 9.81
    travel: float = 6e-3
    x_max: float = 6.6e-3
    sigma_x: float = 6e-6
    sigma_i: float = 2e-3
    tick: float = 2e-3

    @property
    def campaign(self) -> Campaign:
        text = (
            f'[plant]\nname = "independent"\nmass_kg = {self.m}\ntravel_m = {self.travel}\nx_max_m = {self.x_max}\n'
            '[[recording]]\nfile = "in memory"\nkind = "free"\nuse = "fit"\n'
        )
        return parse(text, where="campaign.toml")

    def current(self, x: float) -> float:
        return (self.x_max - x) * math.sqrt(self.m * self.g / self.K_c)

    def step(self, i: float, x: float, v: float, u: float, duration: float) -> tuple[float, float, float]:
        h = duration / SUBSTEPS
        decay = math.exp(-h / self.T_A)
        for _ in range(SUBSTEPS):
            a = (self.K_c * i * i / (self.x_max - x) ** 2 - self.b * v) / self.m - self.g
            x_next = x + h * v + 0.5 * h * h * a
            i = self.K_A * u + (i - self.K_A * u) * decay
            v_half = v + 0.5 * h * a
            a = (self.K_c * i * i / (self.x_max - x_next) ** 2 - self.b * (v_half + 0.5 * h * a)) / self.m - self.g
            x, v = x_next, v_half + 0.5 * h * a
            if x <= 0.0:
                x, v = 0.0, max(-0.4 * v, 0.0) if v < -1e-3 else 0.0
            elif x >= self.travel:
                x, v = self.travel, min(-0.4 * v, 0.0) if v > 1e-3 else 0.0
        return i, x, v

    def closed_loop(
        self, x_ref: Callable[[int], float], ticks: int, *, seed: int, jitter: float = 0.0, name: str = "flight"
    ) -> Record:
        """A flight around mid-travel under an LQI; `jitter`: relative spread of the sampling time."""
        rng = np.random.default_rng(seed)
        x_0 = 0.5 * self.travel
        i_0 = self.current(x_0)
        i, x, v, s, x_before = i_0, x_0, 0.0, 0.0, x_0
        rows = []
        t = 0.0
        for k in range(ticks):
            i_m, x_m = i + self.sigma_i * rng.normal(), x + self.sigma_x * rng.normal()
            u = i_0 / self.K_A - (
                0.49 * (i_m - i_0) + 2000.0 * (x_m - x_0) + 18.0 * (x_m - x_before) / self.tick - 17600.0 * s
            )
            u = min(max(u, 0.0), 5.0)
            s += (x_ref(k) - x_m) * self.tick
            rows.append((t, u, i_m, x_m, x_ref(k)))
            duration = self.tick * (1.0 + jitter * rng.uniform(-1.0, 1.0))
            i, x, v = self.step(i, x, v, u, duration)
            t += duration
            x_before = x_m
        return as_record(name, "closed-loop", rows)

    def driven(self, u: Callable[[int], float], ticks: int, *, seed: int, kind: Kind, name: str) -> Record:
        """Simulate the plant from rest under a given input: steps, ramps, PRBS; the ball may hit both stops."""
        rng = np.random.default_rng(seed)
        i, x, v = 0.0, 0.0, 0.0
        rows = []
        for k in range(ticks):
            rows.append(
                (k * self.tick, u(k), i + self.sigma_i * rng.normal(), x + self.sigma_x * rng.normal(), math.nan)
            )
            i, x, v = self.step(i, x, v, u(k), self.tick)
        return as_record(name, kind, rows)


def as_record(name: str, kind: Kind, rows: list[tuple[float, float, float, float, float]]) -> Record:
    table = np.array(rows)
    return Record(
        name=name,
        kind=kind,
        use="fit",
        t=table[:, 0],
        u_c=table[:, 1],
        i_c=table[:, 2],
        x=table[:, 3],
        x_ref=table[:, 4],
    )


def wandering(seed: int, ticks: int, *, middle: float = 3e-3, span: float = 0.7e-3) -> Callable[[int], float]:
    """A reference that jumps every 0.2 s."""
    levels = np.random.default_rng(seed).uniform(middle - span, middle + span, ticks // 100 + 1)
    return lambda k: float(levels[k // 100])
