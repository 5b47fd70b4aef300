"""The definition of a cause: a physical effect that (1) and (6) leave out, with its parameters and traits.

Rule 1: a cause at its neutral value is exactly absent: the extended model is then the paper's, bit by bit.
Rule 2: every parameter has a place of its own in the vector `c` that the kernels take; a test holds them apart.
Rule 3: the estimator moves a coordinate that is 0 at neutral: value - neutral, or 1 / value where neutral is infinite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

Family = Literal["amplifier", "force", "motion", "sensing", "timing"]
Trait = Literal[
    "displaces",  # coil, stop or sensor sits elsewhere: places that are one but for bends
    "delays",  # by a fixed time, which step responses show directly
    "hidden-state",  # adds a state that no channel measures, a delay's memory among them
    "sticks",  # can hold the ball where it is, whatever the other forces do
    "of-the-gap",  # its equation has the distance of ball and coil in it
    "warms",  # comes and goes with the warmth of the coil
]
# In innovations, in their spectrum (a force, or an error of a sensor), in the times of samples; no causes are a curve,
# found in what is left, and an error of what the campaign states, which only competes with a named cause.
Detector = Literal["score-test", "spectral-line", "sensor-line", "gaps", "remainder", "stated"]
AtRest = Literal["", "balance", "amplifier"]
PLACES = 154
NO_PLACE = -1  # of a parameter that acts before the kernels


class Vector(Protocol):
    """The parameters of all causes, an array of shape (PLACES,), as the kernels read it."""

    def __getitem__(self, index: int, /) -> float: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseParameter:
    """A parameter of a cause, in the unit that its name ends with."""

    name: str
    symbol: str
    unit: str = ""  # empty: a pure number
    index: int  # in the vector c, or NO_PLACE
    neutral: float = 0.0  # absent; inf for limits
    low: float  # of the physical range
    high: float
    probes: tuple[float, ...]  # where the screen looks: small, no rounding error; larger where the signature bends
    # Of a shape, which the data often leave open: the standard deviation of its prior about neutral; inf: none.
    spread: float = math.inf
    logarithmic: bool = False  # its coordinate is its logarithm, as it may lie anywhere within decades
    walks: bool = False  # the strength is a random walk, and this its standard deviation after a minute
    random: bool = False  # a standard deviation, of which a simulation has nothing

    def coordinate(self, value: float) -> float:
        """The number that the estimator moves."""
        if math.isinf(self.neutral):
            return 1.0 / value
        return math.log(value / self.neutral) if self.logarithmic else value - self.neutral

    def value(self, coordinate: float) -> float:
        """The parameter of a coordinate, within its physical range."""
        if math.isinf(self.neutral):
            return math.inf if coordinate <= 0.0 else min(max(1.0 / coordinate, self.low), self.high)
        # A hundred is beyond each range, where the exponential does not overflow yet.
        value = self.neutral * math.exp(min(coordinate, 100.0)) if self.logarithmic else self.neutral + coordinate
        return min(max(value, self.low), self.high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """An equation of the literature for the same effect.

    `values` are those of the shape parameters, or the name of a parameter that has the same value; a shape that is not
    named is neutral.
    """

    name: str
    values: Mapping[str, float | str]
    source: str
    probed: bool = False  # whether the screen looks at it, too: its signature is unlike that of the usual form


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredProbes:
    """Probes at the sizes at which given recordings would show a cause: a size that they have, times some factors.

    A limit far above the recorded values has no effect, and one far below contradicts everything.  Its signature
    resembles the effect only near the largest current or the fastest change that was recorded.
    """

    of: Literal["largest-current", "fastest-change", "sampling-interval"]
    times: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """An entry of the catalogue.  The first parameter is the strength; others (a time constant) shape it."""

    name: str
    family: Family
    title: str  # plain words, without a size
    acts_on: str  # quantity of the loop, in the words of `curve.FREE_FORM_OF` where a curve acts on it, too
    equation: str
    source: str
    parameters: tuple[CauseParameter, ...]
    signature: str  # what it leaves in recordings
    shows_in: tuple[str, ...]  # experiments of `board51 campaign run`, best first
    confirm: str  # by hand, at the rig
    cure: str
    needs: tuple[str, ...] = ("u_c", "i_c", "x")  # channels without which it cannot be tested
    not_testable: str = ""  # why no recording of this rig can show it
    # With sizes: {parameter} is its magnitude with unit, {parameter:%} its distance from neutral in percent.
    sentence: str = ""
    opposite: str = ""  # the same where the strength is below neutral, for those that have a sign
    usual: str = ""  # the form in which all shapes are neutral
    forms: tuple[Form, ...] = ()  # the others
    traits: frozenset[Trait] = frozenset()
    detector: Detector = "score-test"
    measured_probes: MeasuredProbes | None = None  # instead of the strength's own for a limit, else beside them
    same_samples_as: str = ""  # the cause that does exactly the same to the samples: fitted once
    not_simulated: str = ""  # why a simulation does without it
    # What points of rest show of it: the force balance or its sensors, or what flows where i_c was computed as K_A u_c.
    at_rest: AtRest = ""
    added_a: Callable[[float, float], float] | None = None  # of (strength, K_A): flows at rest beside K_A u_c, A
    # Name of another cause: the measurement beside the board that decides between the two.
    deciding_measurements: Mapping[str, str] = field(default_factory=dict)

    @property
    def strength(self) -> CauseParameter:
        """The parameter that is neutral when the cause is absent."""
        return self.parameters[0]

    @property
    def shapes(self) -> tuple[CauseParameter, ...]:
        """The parameters that tell one form of the effect from another."""
        return tuple(shape for shape in self.parameters if math.isfinite(shape.spread))
