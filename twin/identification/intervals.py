"""95 % intervals: from the covariance if the log-likelihood is nearly a parabola, otherwise from its profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.distributions import Z_95
from twin.identification.fit import Blocks, fit
from twin.inference.optimiser import Fit
from twin.inference.theta import FLOORS, PARAMETERS, moved
from twin.settings import identification as settings

_ROUNDS = 6
_PASSES = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """The fitted value of one parameter with its interval, in its own unit."""

    value: float
    std: float
    low: float
    high: float
    method: str  # Fisher information | sandwich | profile likelihood


def quadratic_or_profile(likelihood: Blocks, fitted: Fit, robust: Fit | None) -> dict[str, Interval]:
    """Return the intervals of the free parameters at the maximum, by name.

    `robust` has the sandwich covariance, where the residuals are coloured.
    """
    plant = likelihood.plant
    result = {}
    for name in PARAMETERS:
        if name not in fitted.free:
            continue
        std = (robust or fitted).std(name, plant)
        value = fitted.theta.value(name)
        relative = std / value if name != "b" and value > 0 else 0.0
        floored = name == "T_A" and value <= FLOORS[name] * 1.001  # no standard error and no lower end
        # The parabola is taken where it holds, because a profile costs several fits for each end.
        crooked = (
            floored
            or relative > settings.PROFILE_FROM
            or (name == "b" and abs(value) < settings.SMALL_DRAG * std)
            or not np.isfinite(std)
        )
        if not crooked:
            low, high = (
                (value - Z_95 * std, value + Z_95 * std)
                if name == "b"
                else (value * float(np.exp(-Z_95 * relative)), value * float(np.exp(Z_95 * relative)))
            )
            method = "sandwich covariance (residuals are coloured)" if robust else "Fisher information"
        else:
            # With coloured residuals the profile is too narrow by the ratio of the two standard errors.
            inflate = max(std / max(fitted.std(name, plant), 1e-300), 1.0) if robust and np.isfinite(std) else 1.0
            high = _profile(likelihood, fitted, name, 1, Z_95 * inflate)
            low = 0.0 if floored else _profile(likelihood, fitted, name, -1, Z_95 * inflate)
            std = float("inf") if floored else std
            method = "profile likelihood"
        result[name] = Interval(value=value, std=std, low=low, high=high, method=method)
    return result


def _profile(likelihood: Blocks, fitted: Fit, name: str, side: int, target: float) -> float:
    """Return the value at which the signed root of the likelihood ratio reaches `target`; 0 or inf if it does not."""
    plant = likelihood.plant
    std = fitted.std(name, plant)
    value = fitted.theta.value(name)
    distance = target * (std / plant.mass_kg if name == "b" else std / value) if np.isfinite(std) and std > 0 else 0.5
    max_distance = 200.0 if name == "b" else settings.BOUND_FARTHEST
    distance = min(distance, max_distance)
    free = tuple(other for other in fitted.free if other != name)
    below, above = 0.0, np.inf
    start = fitted.theta
    for _ in range(_ROUNDS):
        at = moved(fitted.theta, name, side * distance, plant)
        refit = fit(likelihood, start.having(name, at.value(name)), free, passes=_PASSES)
        start = refit.theta
        # The signed root of the likelihood ratio (S. S. Wilks, 1938): it is the number of standard errors, whatever
        # scale the parameter has.
        root = float(np.sqrt(max(2.0 * (fitted.loglik - refit.loglik), 0.0)))
        if abs(root - target) < 0.03 * target:
            break
        below, above = (max(below, distance), above) if root < target else (below, min(above, distance))
        if root < target and distance >= max_distance:
            return 0.0 if side < 0 and name != "b" else side * float("inf")
        # The root is proportional to the distance for a parabola, so this secant step needs fewer fits than bisection.
        guess = distance * target / root if root > 0.05 * target else distance * 4.0
        if not below < guess < above:
            guess = 0.5 * (below + above) if np.isfinite(above) else distance * 2.0
        distance = min(guess, max_distance)
    return moved(fitted.theta, name, side * distance, plant).value(name)
