"""Robust stability: parameters over their 95 % intervals, positions over the travel.

Rule 1: the parameters are drawn independently and uniformly from the box of their intervals, and its corners are added.
        The errors of a fit are correlated, so the box is larger than the data allow: the check is conservative.
Rule 2: the gains are constant.  The equilibrium is that of the drawn parameters, as the integrator would find it.
Rule 3: a parameter without an interval is not varied, and the result lists it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twin.control import discrete
from twin.control_design.loop import Controller, Plant, radius
from twin.inference.theta import parameter_of
from twin.model.parameters import PARAMETERS, Model, Parameter

SAMPLES = 400
POSITIONS = 39
CORNERS = 256  # all corners of eight parameters; with more parameters only a part of them


@dataclass(frozen=True, slots=True, kw_only=True)
class Robustness:
    """Stability of one controller on plants of the box."""

    varied: Mapping[str, tuple[float, float]]  # the box
    fixed: tuple[str, ...]  # parameters without an interval
    loops: int
    unstable_share: float
    worst_pole: float  # largest |pole| of all
    worst_at: Mapping[str, float]  # parameters of that loop


def over_intervals(model: Model, controller: Controller, x_m: float, sample_time_s: float, *, seed: int) -> Robustness:
    """Close the loop of `controller` with plants drawn from the intervals of `model`, linearised at `x_m`."""
    box = {}
    causes = {f"{cause.name}.{name}": p for cause in model.causes for name, p in cause.parameters.items()}
    listed = {**model.parameters, **causes}
    for name, parameter in listed.items():
        if parameter.ci95 is not None:
            low, high = (_within_range(name, end) for end in sorted(parameter.ci95))
            if high > low:
                box[name] = (low, high)
    fixed = tuple(name for name in listed if name not in box)
    rng = np.random.default_rng(seed)
    # Corners and random points: corners alone miss an instability inside the box, random points hardly reach the
    # corners.
    ends = list(itertools.islice(itertools.product(*box.values()), CORNERS))  # [()] without a box
    plants = [dict(zip(box, corner, strict=True)) for corner in ends]
    if box:
        plants += [{name: float(rng.uniform(*ends)) for name, ends in box.items()} for _ in range(SAMPLES)]
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
    """Return the (lowest, highest) position, m, up to which all linearisations from `x_m` are stable, on a grid."""
    travel = model.plant.travel_m
    grid = (travel * np.arange(1, POSITIONS + 1) / (POSITIONS + 1)).tolist()

    def stable(x: float) -> bool:
        return radius(plant_at(model, x, sample_time_s), controller) < 1.0

    # Outwards: beyond the first unstable position the ball is lost, even if a farther one is stable.
    below = list(itertools.takewhile(stable, (x for x in reversed(grid) if x < x_m)))
    above = list(itertools.takewhile(stable, (x for x in grid if x > x_m)))
    return min(below, default=x_m), max(above, default=x_m)


def plant_at(model: Model, x_m: float, sample_time_s: float) -> Plant:
    """Linearise and discretise by (14) and (15) at `x_m`, with the model's delays."""
    return Plant(*discrete(model, x_m, sample_time_s))


def _within_range(name: str, value: float) -> float:
    """Limit the value of a parameter of the paper, or of a "cause.parameter", to its physical range."""
    if name in PARAMETERS:
        _, low, high = PARAMETERS[name]
    else:
        low, high = parameter_of(name).low, parameter_of(name).high
    return min(max(value, low), high)


def _with(model: Model, values: Mapping[str, float]) -> Model:
    def changed(prefix: str, parameters: Mapping[str, Parameter]) -> dict[str, Parameter]:
        return {
            name: dataclasses.replace(p, value=values.get(prefix + name, p.value)) for name, p in parameters.items()
        }

    causes = tuple(
        dataclasses.replace(cause, parameters=changed(f"{cause.name}.", cause.parameters)) for cause in model.causes
    )
    return dataclasses.replace(model, parameters=changed("", model.parameters), causes=causes)
