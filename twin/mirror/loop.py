"""The free-running twin: the model under its own copy of the board's law, fed with nothing but x_ref.

Rule 1: in closed loop no measurement enters after the start: the twin does what the model says the loop does.
Rule 2: the state held is the one at the tick of the next sample: look at it, then run the tick.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.compiled import Packed, kernel
from twin.control import LawNumbers, law
from twin.simulate import PlantNumbers, tick


@kernel
def closed_loop_tick(
    plant: Packed, law_: Packed, i: float, x: float, v: float, s: float, x_prev: float, x_ref: float
) -> tuple[float, float, float, float, float]:
    """(u_c of this tick, then i_c, x, x' and the integral at the next): V, A, m, m/s, m s."""
    u, s = law(LawNumbers(*law_), i, x, x_prev, s, x_ref)
    i, x, v = tick(PlantNumbers(*plant), i, x, v, u)
    return u, i, x, v, s


@kernel
def driven_tick(plant: Packed, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """(i_c, x, x') one tick later under u_c = u."""
    return tick(PlantNumbers(*plant), i, x, v, u)


@dataclass(slots=True, kw_only=True)
class FreeTwin:
    """Own states of the twin at the tick of the coming sample."""

    plant: Packed  # PlantNumbers
    law: Packed  # LawNumbers
    i: float  # i_c, A
    x: float  # m
    v: float  # x', m/s
    s: float = 0.0  # integral of (x_ref - x) dt, m s
    x_prev: float = 0.0  # x at the tick before, for the law's speed, m

    def follow(self, x_ref: float) -> float:
        """Run one tick in closed loop; returns the twin's own u_c of this tick, V."""
        x = self.x
        u, self.i, self.x, self.v, self.s = closed_loop_tick(
            self.plant, self.law, self.i, x, self.v, self.s, self.x_prev, x_ref
        )
        self.x_prev = x
        return u

    def drive(self, u: float) -> None:
        """Run one tick under the given u_c (open loop, idle), V."""
        self.x_prev = self.x
        self.i, self.x, self.v = driven_tick(self.plant, self.i, self.x, self.v, u)
