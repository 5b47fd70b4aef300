"""How many filter steps a run takes: the substeps of the extended model, which are nine tenths of a diagnosis.

They take 60 to 80 ns each, whatever causes are in the model: 125 ns under motional-emf, the dearest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.estimation.ekf import ALONE, ALONG, RECORDS, states_in
from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.estimation.rollout_periodic import PHASES, has_phase
from twin.model.causes import (
    actuation_delay,
    coulomb_friction,
    freewheel_diode,
    position_dependent_inductance,
    sampling_delay,
    slew_rate_limit,
)
from twin.model.extended import PARTS, SHORT_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """What a run of the filter along one series takes."""

    samples: int
    flown: int  # substeps of the model with the ball in flight
    held: int

    def steps(self, c: NDArray[np.float64], mode: int) -> float:
        """Filter steps of a run.

        Args:
            c: the causes' parameters.
            mode: of `run_along`.
        """
        rubs, states = c[coulomb_friction.FORCE] != 0.0, states_in(c)
        advances = {ALONE: 1, RECORDS: 1, ALONG: 1}.get(mode, 0)
        if mode in (ALONE, RECORDS):
            advances += states + (3 if rubs else 0)
        # The current of a held ball needs no integration where the amplifier is (1).
        linear = states == 3 and c[slew_rate_limit.RATE] == math.inf
        linear = linear and c[position_dependent_inductance.GROWTH] == 0.0 and c[freewheel_diode.DROP] == 0.0
        pieces = 2 if c[actuation_delay.DELAY] + c[sampling_delay.DELAY] > 0.0 else 1
        return self.samples + pieces * (advances * self.flown + (0 if linear else 2 * self.held))

    def steps_ahead(self, c: NDArray[np.float64], samples: int) -> float:
        """Filter steps of `measure.predictions`, so many samples ahead; a force with a phase runs for each phase."""
        return (PHASES if has_phase(c) else 1) * (self.steps(c, ALONE) + samples * self.flown)


def pace_of(series: Series) -> Pace:
    """The pace of a run along a series."""
    follows, flies = series.flags & FOLLOWS != 0, series.flags & FLIES != 0
    substeps = np.where(series.step < SHORT_S, 1, len(PARTS))
    return Pace(
        samples=len(series),
        flown=int(substeps[follows & flies].sum()),
        held=int(substeps[follows & ~flies].sum()),
    )
