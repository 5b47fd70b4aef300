"""The cost of a run of the filter, in substeps of the extended model, which take three quarters of a diagnosis.

A substep takes 0.08 to 0.2 us (`twin/diagnosis/matrix.md`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from twin.estimation.ekf.memory import active_states
from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.estimation.propagate import delay_s
from twin.estimation.rollout_periodic import PHASES, has_phase
from twin.model.causes import coulomb_friction
from twin.model.extended import CORE, FIELD, I_SENSOR, SECOND, Base, has_first_order_current
from twin.model.integration import PARTS, SHORT_S, short


class Reuse(Enum):
    """The parts of a nearby model's run that a run of the filter reuses."""

    NONE = auto()
    SLOPES = auto()  # the Jacobians
    GAINS = auto()  # the Kalman gains, for a model with the same readings and noise; its covariance is the same, too
    STEPS = auto()  # the steps themselves, for a model that differs only in its noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """Counts of one series that determine the cost of a run."""

    samples: int
    flown: tuple[int, int]  # with the ball in flight: samples, and substeps where they are shorter
    held: tuple[int, int]  # the same with the ball held
    step_s: float  # the usual interval in flight

    def steps(self, base: Base, c: NDArray[np.float64], reuse: Reuse) -> float:
        """Return the filter steps of a run.

        Args:
            base: the paper's parameters and the plant.
            c: the causes' parameters, shape (PLACES,).
            reuse: what the run reuses from another.
        """
        rubs, states = c[coulomb_friction.FORCE] != 0.0, active_states(c)
        advances = 0 if reuse is Reuse.STEPS else 1
        if reuse is Reuse.NONE:
            # A difference for each state; with dry friction those of i_c, x and x' are taken to both sides.
            advances += len(states) + (3 if rubs else 0)
        # The current of a held ball alone needs no substeps.
        lags = any(state in (FIELD, SECOND, CORE, I_SENSOR) for state in states)
        held = 2.0 if lags else 0.0 if has_first_order_current(c) else 0.25
        held *= {Reuse.NONE: 1.0, Reuse.STEPS: 0.0}.get(reuse, 0.5)
        pieces = 2 if delay_s(c) > 0.0 else 1
        substepped = 0 if short(base, c, self.step_s) else 1
        return self.samples + pieces * (advances * self.flown[substepped] + held * self.held[substepped])

    def steps_ahead(self, base: Base, c: NDArray[np.float64], samples: int) -> float:
        """Return the steps of `measure.predictions`, `samples` ahead; a periodic force takes a run for each phase."""
        return (PHASES if has_phase(c) else 1) * (
            self.steps(base, c, Reuse.NONE) + samples * self.flown[0 if short(base, c, self.step_s) else 1]
        )


def pace_of(series: Series) -> Pace:
    """The pace of a run along a series."""
    follows, flies = series.flags & FOLLOWS != 0, series.flags & FLIES != 0
    substeps = np.where(series.step < SHORT_S, 1, len(PARTS))
    flown, held = follows & flies, follows & ~flies
    return Pace(
        samples=len(series),
        flown=(int(flown.sum()), int(substeps[flown].sum())),
        held=(int(held.sum()), int(substeps[held].sum())),
        step_s=float(np.median(series.step[flown])) if flown.any() else math.inf,
    )
