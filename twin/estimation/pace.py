"""How many filter steps a run takes: the substeps of the extended model, which are nine tenths of a diagnosis.

They take 60 to 80 ns each, whatever causes are in the model: 125 ns under motional-emf, the dearest.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from twin.estimation.ekf.memory import states_in
from twin.estimation.ekf.predict import amplifier_alone
from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.estimation.propagate import delay_s
from twin.estimation.rollout_periodic import PHASES, has_phase
from twin.model.causes import (
    coulomb_friction,
)
from twin.model.extended import PARTS, SHORT_S


class Reuse(Enum):
    """What a run of the filter takes over from that of a model nearby."""

    NOTHING = auto()
    SLOPES = auto()  # of the steps
    STEPS = auto()  # themselves: of a model that differs in its noise alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """What a run of the filter along one series takes."""

    samples: int
    flown: int  # substeps of the model with the ball in flight
    held: int

    def steps(self, c: NDArray[np.float64], reuse: Reuse) -> float:
        """Filter steps of a run.

        Args:
            c: the causes' parameters.
            reuse: what the run takes over from another.
        """
        rubs, states = c[coulomb_friction.FORCE] != 0.0, states_in(c)
        advances = 0 if reuse is Reuse.STEPS else 1
        if reuse is Reuse.NOTHING:
            advances += states + (3 if rubs else 0)
        # The current of a held ball needs no integration where the amplifier is (1).
        linear = states == 3 and amplifier_alone(c)
        pieces = 2 if delay_s(c) > 0.0 else 1
        return self.samples + pieces * (advances * self.flown + (0 if linear else 2 * self.held))

    def steps_ahead(self, c: NDArray[np.float64], samples: int) -> float:
        """Filter steps of `measure.predictions`, so many samples ahead; a force with a phase runs for each phase."""
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
