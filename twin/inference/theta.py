"""The parameters of the extended model, and the coordinates in which a search moves them.

Rule 1: a coordinate moves in units in which 1 is a moderate change.  These are logarithms, b / m in 1/s, 10 um for
        stops, and the first probe of each cause.  What may lie anywhere within decades moves by its logarithm, too.
Rule 2: bounds are physical: a cause stays within its range, and b is not negative unless `min_b` allows it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.estimation.record import FloatArray
from twin.estimation.structures import COLOURS as COLOURS
from twin.estimation.structures import NOISES as NOISES
from twin.estimation.structures import NoiseLevels, Samples, Stops, System
from twin.model.causes import stated
from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.causes.cause import NO_PLACE, CauseParameter
from twin.model.extended import Base, position_of_reading, position_reading

PARAMETERS = ("K_A", "T_A", "K_c", "b")
STOPS = ("stop_low_m", "stop_high_m")
BASE = PARAMETERS + NOISES
# T_A: faster than any coil; below, the likelihood is flat and a climb would not converge.
FLOORS = {"T_A": 2e-6, "process_i_c_a": 1e-6, "process_a_m_s2": 1e-3}
TAU_S = (2e-4, 0.1)  # correlation times of coloured noise; a slower one is an offset that wanders
WHITE = (1e-3, 0.98)  # white share of the variance of coloured noise
STOP_UNIT_M = 1e-5  # rule 1
_RESTART_M_S2 = 0.3  # process noise at which its logarithm moves the likelihood
# Below the first, no sampling shows a T_A, so its logarithm cannot recover; at the second it can.
_FLAT_T_A_S, _RESTART_T_A_S = 1e-5, 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Theta:
    """The parameters of the extended model in SI units; those of causes are named `cause.parameter`."""

    K_A: float
    T_A: float
    K_c: float
    b: float
    sigma_i_c_a: float
    sigma_x_m: float
    process_i_c_a: float
    process_a_m_s2: float
    stop_low_m: float = 0.0
    stop_high_m: float = 0.0
    causes: tuple[tuple[str, float], ...] = ()  # (coordinate, value), in the order of acceptance
    # Phases of a periodic force, as shifts of the time of each recording, s: its clock is not the board's.  (): all 0.
    phases_s: tuple[float, ...] = ()
    min_sigma_i_c_a: float = 1e-6  # lower bound: a noise level at 0 could not recover
    min_sigma_x_m: float = 1e-8
    min_b: float = 0.0  # lower bound; -inf where the interval of b must be right although it reaches 0
    closed_form: bool = False  # as in `System`; only without causes
    # The colour of the noise, as `NoiseLevels` has it.
    tau_i_c_s: float = 0.0
    white_i_c: float = 1.0
    tau_x_s: float = 0.0
    white_x: float = 1.0
    tau_i_c_captured_s: float = 0.0
    white_i_c_captured: float = 1.0

    def value(self, name: str) -> float:
        """The value of one parameter; that of an absent cause is its neutral value."""
        if "." not in name:
            return float(getattr(self, name))
        return dict(self.causes).get(name, parameter_of(name).neutral)

    def having(self, name: str, value: float) -> Theta:
        """A copy with one parameter changed."""
        if "." not in name:
            number: dict[str, Any] = {name: value}
            return replace(self, **number)
        return replace(self, causes=tuple({**dict(self.causes), name: value}.items()))

    def all_of(self, values: Iterable[tuple[str, float]]) -> Theta:
        """A copy with several parameters changed."""
        theta = self
        for name, value in values:
            theta = theta.having(name, value)
        return theta

    def without(self, cause: str, plant: Plant) -> Theta:
        """A copy without one cause, with the same readings at rest."""
        left = replace(self, causes=tuple(pair for pair in self.causes if not pair[0].startswith(cause + ".")))
        return with_equal_rests(left, self, cause, plant)

    def vector(self) -> NDArray[np.float64]:
        """The vector c of the causes' parameters for the kernels."""
        c = neutral()
        for name, value in self.causes:
            if (place := parameter_of(name).index) != NO_PLACE:
                c[place] = value
        stated.rescale_sensor(c, dict(self.causes))
        return c

    def base(self, plant: Plant) -> Base:
        """The paper's parameters for the kernels, with the errors of stated values."""
        plant = stated.corrected(plant, dict(self.causes))
        return Base(
            K_A=self.K_A,
            T_A=self.T_A,
            K_c=self.K_c,
            b=self.b,
            mass_kg=plant.mass_kg,
            gravity_m_s2=plant.gravity_m_s2,
            x_max_m=plant.x_max_m,
            travel_m=plant.travel_m,
        )

    def samples(self, samples: Samples, recording: NDArray[np.int32]) -> Samples:
        """Return the samples on the time base of the model; `recording`: of each sample, shape (n,)."""
        values = dict(self.causes)
        clock, inputs = stated.factor(values, stated.CLOCK), stated.factor(values, stated.INPUT)
        if clock != 1.0 or inputs != 1.0:
            samples = samples._replace(t=samples.t * clock, step=samples.step * clock, u=samples.u * inputs)
        return samples._replace(t=samples.t + np.array(self.phases_s)[recording]) if self.phases_s else samples

    def noise(self, tick_s: float) -> NoiseLevels:
        """The noise levels, as the filter takes them; `tick_s`: that they refer to, s."""
        levels = self.sigma_i_c_a, self.sigma_x_m, self.process_i_c_a, self.process_a_m_s2
        return NoiseLevels(*levels, tick_s, *(self.value(name) for name in COLOURS))

    @property
    def colours(self) -> tuple[str, ...]:
        """The coordinates of the colour of its noise; none where all is white."""
        pairs = zip(COLOURS[::2], COLOURS[1::2], strict=True)
        return tuple(name for pair in pairs if self.value(pair[0]) > 0.0 for name in pair)

    def system(self, plant: Plant, tick_s: float) -> System:
        """The model and its noise, as the filter takes them; `tick_s`: that process noise refers to, s."""
        stops = Stops(self.stop_low_m, self.stop_high_m)
        return System(tuple(self.base(plant)), self.vector(), self.noise(tick_s), stops, self.closed_form)


def parameter_of(name: str) -> CauseParameter:
    """The definition of the parameter named `cause.parameter`."""
    cause, _, parameter = name.partition(".")
    return next(entry for entry in BY_NAME[cause].parameters if entry.name == parameter)


def coordinates_of(cause: str) -> tuple[str, ...]:
    """The coordinates of a cause: all its parameters."""
    return tuple(f"{cause}.{entry.name}" for entry in BY_NAME[cause].parameters)


_SHAPES = tuple(shape for cause in BY_NAME.values() for shape in cause.shapes)
_PLACES = np.array([shape.index for shape in _SHAPES], np.intp)
_NEUTRAL = np.array([shape.neutral for shape in _SHAPES])
_SPREAD = np.array([shape.spread for shape in _SHAPES])


def shape_residuals(theta: Theta) -> FloatArray:
    """Return the distance of each cause's shape from its usual form, in standard deviations of its prior.

    The data often leave a shape open; without a prior a fit would then have no maximum.
    """
    return np.asarray((theta.vector()[_PLACES] - _NEUTRAL) / _SPREAD)


def prior_spread(name: str) -> float:
    """Return the standard deviation of the prior of a coordinate, in its unit; inf where there is none."""
    if "." not in name:
        return math.inf
    parameter = parameter_of(name)
    return parameter.spread / unit_of(parameter)


def unit_of(parameter: CauseParameter) -> float:
    """The change of a cause's coordinate that counts as 1."""
    scale = abs(parameter.coordinate(parameter.probes[0]))
    if scale > 0.0:
        return scale
    return 0.3 if parameter.logarithmic else 0.3 * abs(parameter.neutral)


def moved(theta: Theta, name: str, step: float, plant: Plant) -> Theta:
    """Return a copy with one coordinate moved, within its bounds."""
    value = theta.value(name)
    if "." in name:
        parameter = parameter_of(name)
        coordinate = parameter.coordinate(value) + step * unit_of(parameter)
        after = theta.having(name, parameter.value(coordinate))
        if after.value(name) == value:  # at a bound, where rounding of the stops would look like a move
            return after
        # The readings at rest are known far better than where the stops are: with fixed stops, the likelihood would be
        # a narrow curved ridge.
        return with_equal_rests(after, theta, name.partition(".")[0], plant)
    if name == "b":
        # b moves linearly, as a logarithm could not reach 0. Beyond the unstable pole it would imitate another effect.
        return replace(theta, b=min(max(value + step * plant.mass_kg, theta.min_b), max_drag(plant)))
    if name in STOPS:
        return theta.having(name, value + step * STOP_UNIT_M)
    if name in COLOURS:
        low, high = TAU_S if name.startswith("tau") else WHITE
        return theta.having(name, min(max(value * math.exp(step), low), high))
    return theta.having(name, max(value * math.exp(step), _floor(theta, name)))


def with_equal_rests(theta: Theta, before: Theta, cause: str, plant: Plant) -> Theta:
    """Return a copy whose sensor reads at the stops what `before` reads there, if it differs by a cause of a sensor."""
    if BY_NAME[cause].family != "sensing":
        return theta
    p, c, c_before = before.base(plant), theta.vector(), before.vector()
    low, high = (
        float(position_of_reading(p, c, position_reading(p, c_before, stop, 0.0), 0.0))
        for stop in (before.stop_low_m, plant.travel_m + before.stop_high_m)
    )
    return replace(theta, stop_low_m=low, stop_high_m=high - plant.travel_m)


def _floor(theta: Theta, name: str) -> float:
    return {"sigma_i_c_a": theta.min_sigma_i_c_a, "sigma_x_m": theta.min_sigma_x_m}.get(name, FLOORS.get(name, 0.0))


def reinitialised(theta: Theta) -> Theta:
    """Raise process noise and T_A from where the likelihood is flat and a climb would not leave it."""
    return replace(
        theta,
        T_A=theta.T_A if theta.T_A > _FLAT_T_A_S else _RESTART_T_A_S,
        process_i_c_a=max(theta.process_i_c_a, 0.3 * theta.sigma_i_c_a),
        process_a_m_s2=max(theta.process_a_m_s2, _RESTART_M_S2),
    )


def max_drag(plant: Plant) -> float:
    """Return the upper bound of b, N s/m: the drag that equals the unstable pole in the middle of the travel."""
    # The pole of (14) in closed form, as (3) at rest has the slope 2 m g / gap.
    return plant.mass_kg * math.sqrt(2.0 * plant.gravity_m_s2 / (plant.x_max_m - 0.5 * plant.travel_m))


def derivative_step(theta: Theta, name: str, plant: Plant) -> float:
    """A step for differences in that coordinate, inwards at a bound."""
    step = 1e-2 if name == "b" else 0.05 if name in STOPS else 1e-3 if "." in name else 1e-4
    # A one-sided step inwards, not a central difference: that would double the runs, and needs both sides of a bound.
    return step if moved(theta, name, step, plant) != theta else -step


def max_step(name: str) -> float:
    """The largest move of a coordinate in one pass."""
    if name == "b":
        return 20.0
    if name in STOPS:
        return 10.0
    if "." in name:
        return 5.0
    return 1.5 if name in NOISES or name == "T_A" else 0.5
