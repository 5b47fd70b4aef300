"""The maximum of the likelihood: Fisher scoring with Levenberg damping, as in `twin/identify/fit.py`.

A coordinate at its bound that wants further out is left there.  Far from the maximum the derivatives are those that
`Criterion.derivatives` has for less work.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.diagnose import settings
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.theta import NOISES, Theta, most_step, moved
from twin.estimation.optimiser import Damping, covariance_of, newton
from twin.estimation.record import FloatArray

DONE = 0.02  # of a standard error
NEAR = 0.3
CLOSE = 3.0  # standard errors from the maximum: the derivatives are as good as those of the next point


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A maximum and what is known about it."""

    theta: Theta
    loglik: float
    free: tuple[str, ...]
    covariance: FloatArray  # of the coordinates
    converged: bool
    ahead: float = 0.0  # log-likelihood that the slope here still promises, were it a parabola

    def std(self, name: str, plant: Plant) -> float:
        """Standard error in the number's own unit; inf where it was not free."""
        if name not in self.free:
            return math.inf
        place = self.free.index(name)
        spread = math.sqrt(max(float(self.covariance[place, place]), 0.0))
        here = self.theta.value(name)
        beyond = moved(self.theta, name, 1e-3, plant).value(name)
        if beyond == here:
            beyond = moved(self.theta, name, -1e-3, plant).value(name)
        return spread * abs(beyond - here) / 1e-3


def spreads(criterion: Criterion, fit: Fit) -> dict[str, float]:
    """Standard errors of all free numbers, in their own units, at fresh derivatives."""
    _, score, fisher = criterion.gradient(fit.theta, fit.free)
    active = _active(fit.theta, fit.free, score, criterion.plant)
    at = replace(fit, covariance=covariance_of(fisher, active))
    return {name: at.std(name, criterion.plant) for name in fit.free}


def climb(
    criterion: Criterion, start: Theta, free: Sequence[str], *, passes: int = settings.PASSES, done: float = DONE
) -> Fit:
    """Climb to the maximum from `start`; coordinates not in `free` stay."""
    plant = criterion.plant
    theta, damping, converged, slow = start, Damping(), False, 0
    run = criterion.run(theta)
    rough = criterion.loudness(run.innovations) < settings.EXACT_SLOPES_SQUARE
    base, change = criterion.derivatives(theta, free, run, rough=rough)
    loglik, score, fisher = criterion.slopes(theta, free, base, change)
    decrement, fresh, exact = math.inf, True, not rough
    for _ in range(passes):
        active = _active(theta, free, score, plant)
        step, decrement = newton(score, fisher, active, damping.value)
        if decrement < CLOSE and not exact:
            base, change = criterion.derivatives(theta, free, run)
            loglik, score, fisher = criterion.slopes(theta, free, base, change)
            active, exact = _active(theta, free, score, plant), True
            step, decrement = newton(score, fisher, active, damping.value)
        if decrement < done or (slow >= 2 and decrement < NEAR):
            converged = True
            break
        most = np.array([most_step(name) for name in free])
        # One factor for the physics: the direction stays.  A noise level near its floor has no slope and asks for any
        # step: it is cut by itself, or it would hold back all the others.
        physics = np.array([name not in NOISES for name in free])
        shorter = min([1.0, *(most / np.maximum(np.abs(step), 1e-300))[physics]])
        step = np.where(physics, step * shorter, np.clip(step, -most, most))
        trial = theta
        for place, name in enumerate(free):
            trial = moved(trial, name, step[place], plant)
        beyond = criterion.run(trial)
        value = criterion.loglik(beyond.innovations) + criterion.outside(trial)
        if math.isfinite(value) and value > loglik - 1e-9 * abs(loglik):
            slow = slow + 1 if value - loglik < 0.05 else 0
            damping.taken()
            theta, base, run = trial, beyond.innovations, beyond
            fresh = decrement > CLOSE
            if fresh:
                exact = criterion.loudness(run.innovations) >= settings.EXACT_SLOPES_SQUARE
                base, change = criterion.derivatives(theta, free, run, rough=not exact)
        elif not (fresh and exact):
            base, change = criterion.derivatives(theta, free, run)
            fresh = exact = True
        else:
            if damping.refused():
                continue
            break
        loglik, score, fisher = criterion.slopes(theta, free, base, change)
    active = _active(theta, free, score, plant)
    _, left = newton(score, fisher, active, damping.value)
    return Fit(
        theta=theta,
        loglik=loglik,
        free=tuple(free),
        covariance=covariance_of(fisher, active),
        converged=converged or decrement < NEAR,
        ahead=0.5 * left * left,
    )


def _active(theta: Theta, free: Sequence[str], score: FloatArray, plant: Plant) -> NDArray[np.bool_]:
    """Which coordinates may move: not one at its bound whose score points outwards."""
    return np.array(
        [
            moved(theta, name, 1e-3 * (1.0 if score[place] > 0.0 else -1.0), plant) != theta
            for place, name in enumerate(free)
        ],
        np.bool_,
    )
