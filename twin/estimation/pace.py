"""The cost of a run of the filter, in substeps of the extended model, which take nine tenths of a diagnosis.

A substep takes 60 to 80 ns, and 125 ns with `motional-emf`, the most expensive cause.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from twin.estimation.ekf.memory import active_states
from twin.estimation.ekf.predict import amplifier_alone
from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.estimation.propagate import delay_s
from twin.estimation.rollout_periodic import PHASES, has_phase
from twin.model.causes import (
    coulomb_friction,
)
from twin.model.extended import I_C, PARTS, SHORT_S, WANDER, V, X


class Reuse(Enum):
    """What a run of the filter reuses from that of a nearby model."""

    NOTHING = auto()
    SLOPES = auto()  # the Jacobians
    STEPS = auto()  # the steps themselves, for a model that differs only in its noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """Counts of one series that determine the cost of a run."""

    samples: int
    flown: int  # substeps with the ball in flight
    held: int  # substeps with the ball held

    def steps(self, c: NDArray[np.float64], reuse: Reuse) -> float:
        """Filter steps of a run.

        Args:
            c: the causes' parameters, shape (PLACES,).
            reuse: what the run reuses from another.
        """
        rubs, states = c[coulomb_friction.FORCE] != 0.0, active_states(c)
        advances = 0 if reuse is Reuse.STEPS else 1
        if reuse is Reuse.NOTHING:
            advances += len(states) + (3 if rubs else 0)
        # With the amplifier of (1) the current of a held ball needs no integration.
        linear = amplifier_alone(c) and all(state in (I_C, X, V) or state >= WANDER for state in states)
        pieces = 2 if delay_s(c) > 0.0 else 1
        return self.samples + pieces * (advances * self.flown + (0 if linear else 2 * self.held))

    def steps_ahead(self, c: NDArray[np.float64], samples: int) -> float:
        """Filter steps of `measure.predictions`, `samples` ahead; a periodic force takes a run for each phase."""
        return (PHASES if has_phase(c) else 1) * (self.steps(c, Reuse.NOTHING) + samples * self.flown)


def pace_of(series: Series) -> Pace:
    """The pace of a run along a series."""
    follows, flies = series.flags & FOLLOWS != 0, series.flags & FLIES != 0
    substeps = np.where(series.step < SHORT_S, 1, len(PARTS))
    return Pace(
        samples=len(series),
        flown=int(substeps[follows & flies].sum()),
        held=int(substeps[follows & ~flies].sum()),
    )
