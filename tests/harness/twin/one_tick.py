"""A tick of the simulation as numbers in, numbers out, for tests that look at single ticks."""

from __future__ import annotations

from twin.model.extended import I_C, Base, V, X
from twin.model.simulate import PlantNumbers, hold, rig_at


def tick(plant: PlantNumbers, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """(i_c, x, x') one T_s later, with u_c = u held: A, m, m/s."""
    memory = rig_at(plant, i=i, x=x, v=v, u=u)
    hold(tuple(plant), memory, u)
    return float(memory[I_C]), float(memory[X]), float(memory[V])


def numbers(plant: PlantNumbers) -> Base:
    return Base(*plant.base)
