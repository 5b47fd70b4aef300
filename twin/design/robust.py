"""Does the loop stay stable where the model is wrong: parameters over their 95 % intervals, positions over the travel.

Rule 1: the parameters are drawn independently and uniformly from the box of their intervals, and its corners are added.
        A fit's errors are correlated, so the box holds more than the data allow: a pessimistic check on purpose.
Rule 2: the gains stay, the equilibrium moves with the parameters: the integrator finds it.
Rule 3: a parameter without an interval cannot be varied, and the result says so.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twin.control import c2d, linearise
from twin.design.loop import Controller, Plant, radius
from twin.model.parameters import PARAMETERS, Model

SAMPLES = 400
POSITIONS = 39


@dataclass(frozen=True, slots=True, kw_only=True)
class Robustness:
    """Loops of one controller on plants of the box."""

    varied: Mapping[str, tuple[float, float]]  # the box
    fixed: tuple[str, ...]  # parameters without an interval
    loops: int
    unstable_share: float
    worst_pole: float  # largest |pole| of all
    worst_at: Mapping[str, float]  # parameters of that loop


def over_intervals(
    model: Model, controller: Controller, x_m: float, sample_time_s: float, *, seed: int, samples: int = SAMPLES
) -> Robustness:
    """Close `controller` around plants drawn from the intervals of `model`, at `x_m`."""
    box = {}
    for name, parameter in model.parameters.items():
        if parameter.ci95 is not None:
            _, lowest, highest = PARAMETERS[name]
            low, high = sorted(min(max(end, lowest), highest) for end in parameter.ci95)
            if high > low:
                box[name] = (low, high)
    fixed = tuple(name for name in model.parameters if name not in box)
    rng = np.random.default_rng(seed)
    plants = [dict(zip(box, corner, strict=True)) for corner in itertools.product(*box.values())]  # [{}] without a box
    if box:
        plants += [{name: float(rng.uniform(*ends)) for name, ends in box.items()} for _ in range(samples)]
    radii = [radius(plant_at(_with(model, values), x_m, sample_time_s), controller) for values in plants]
    worst = int(np.argmax(radii))
    return Robustness(
        varied=box,
        fixed=fixed,
        loops=len(radii),
        unstable_share=float(np.mean(np.array(radii) >= 1.0)),
        worst_pole=radii[worst],
        worst_at=plants[worst],
    )


def stable_range_m(model: Model, controller: Controller, x_m: float, sample_time_s: float) -> tuple[float, float]:
    """Positions around `x_m` between which every linearisation is stable, on a grid of the travel; m."""
    travel = model.plant.travel_m
    grid = (travel * np.arange(1, POSITIONS + 1) / (POSITIONS + 1)).tolist()
    low = high = x_m
    for x in reversed([x for x in grid if x < x_m]):
        if radius(plant_at(model, x, sample_time_s), controller) >= 1.0:
            break
        low = x
    for x in [x for x in grid if x > x_m]:
        if radius(plant_at(model, x, sample_time_s), controller) >= 1.0:
            break
        high = x
    return low, high


def plant_at(model: Model, x_m: float, sample_time_s: float) -> Plant:
    """(14) and (15) at `x_m`."""
    return Plant(*c2d(*linearise(model, x_m), sample_time_s))


def _with(model: Model, values: Mapping[str, float]) -> Model:
    changed = {name: dataclasses.replace(model.parameters[name], value=value) for name, value in values.items()}
    return dataclasses.replace(model, parameters={**model.parameters, **changed})
