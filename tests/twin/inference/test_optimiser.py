"""The optimiser on a likelihood that is known in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from protocol.campaign import Plant
from tests.harness.diagnose.simulated_rig import PLANT, THETA
from twin.inference.optimiser import Slopes, climb
from twin.inference.theta import Theta

FREE = ("K_A", "K_c")  # both move in their logarithm


class Valley:
    """A curved valley (H. H. Rosenbrock, The Computer Journal 3(3), 1960) in the logarithms of K_A and K_c."""

    plant: Plant = PLANT

    def __init__(self) -> None:
        self.visited = list[float]()

    def coordinates(self, point: Theta) -> tuple[float, float]:
        return math.log(point.K_A / THETA.K_A), math.log(point.K_c / THETA.K_c)

    def visit(self, point: Theta) -> tuple[float, Any]:
        along, across = self.coordinates(point)
        residuals = 50.0 * np.array([10.0 * (across - along * along), 1.0 - along])
        self.visited.append(-0.5 * float(residuals @ residuals))
        return self.visited[-1], residuals

    def slopes(
        self, point: Theta, outputs: Any, free: Sequence[str], before: Slopes | None, decrement: float
    ) -> Slopes:
        return self.exact(point, outputs, free)

    def exact(self, point: Theta, outputs: Any, free: Sequence[str]) -> Slopes:
        along, _ = self.coordinates(point)
        jacobian = 50.0 * np.array([[-20.0 * along, 10.0], [-1.0, 0.0]])
        return Slopes(score=-jacobian.T @ outputs, fisher=jacobian.T @ jacobian)


def test_a_curved_valley_is_climbed_to_its_end_without_a_step_in_three_that_fails() -> None:
    valley = Valley()

    fit = climb(valley, THETA, FREE, passes=60, tolerance=0.01, patience=2)

    along, across = valley.coordinates(fit.theta)
    best = np.maximum.accumulate(valley.visited)
    failed = int(np.sum(np.array(valley.visited[1:]) < best[:-1]))
    print(len(valley.visited), failed, fit.passes, [round(v, 1) for v in valley.visited])
    assert fit.converged
    assert abs(along - 1.0) < 1e-3
    assert abs(across - 1.0) < 2e-3
    assert failed < fit.passes / 3
