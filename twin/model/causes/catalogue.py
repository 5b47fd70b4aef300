"""THE list of causes, in the order of the signal: amplifier, force, motion, sensing, timing.

A cause is added with its file, its line here, and its call in `twin/model/extended.py` where it acts.  What the search,
the experiments and the design must know of it are fields of `Cause`: no other file names one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.model.causes import (
    actuation_delay,
    air_gap_offset,
    amplifier_dead_zone,
    amplifier_gain_drift,
    amplifier_offset,
    constant_force,
    core_saturation,
    coulomb_friction,
    current_limit,
    current_sensor_gain,
    current_sensor_lag,
    current_sensor_line,
    current_sensor_offset,
    eddy_current_lag,
    force_exponent,
    freewheel_diode,
    lost_samples,
    magnetic_hysteresis,
    motional_emf,
    periodic_disturbance,
    position_dependent_inductance,
    position_sensor_gain,
    position_sensor_lag,
    position_sensor_line,
    position_sensor_nonlinearity,
    position_sensor_offset,
    quadratic_drag,
    residual_magnetism,
    sampling_delay,
    second_time_constant,
    sensor_crosstalk,
    slew_rate_limit,
)
from twin.model.causes.cause import PLACES, Cause, Detector, Trait
from twin.model.causes.curve import CURVES
from twin.model.causes.stated import STATED

CATALOGUE: tuple[Cause, ...] = (
    amplifier_gain_drift.CAUSE,
    current_limit.CAUSE,
    slew_rate_limit.CAUSE,
    amplifier_dead_zone.CAUSE,
    amplifier_offset.CAUSE,
    freewheel_diode.CAUSE,
    position_dependent_inductance.CAUSE,
    motional_emf.CAUSE,
    second_time_constant.CAUSE,
    actuation_delay.CAUSE,
    air_gap_offset.CAUSE,
    force_exponent.CAUSE,
    core_saturation.CAUSE,
    residual_magnetism.CAUSE,
    eddy_current_lag.CAUSE,
    magnetic_hysteresis.CAUSE,
    quadratic_drag.CAUSE,
    coulomb_friction.CAUSE,
    constant_force.CAUSE,
    periodic_disturbance.CAUSE,
    position_sensor_offset.CAUSE,
    position_sensor_gain.CAUSE,
    position_sensor_nonlinearity.CAUSE,
    position_sensor_lag.CAUSE,
    position_sensor_line.CAUSE,
    sensor_crosstalk.CAUSE,
    current_sensor_offset.CAUSE,
    current_sensor_gain.CAUSE,
    current_sensor_lag.CAUSE,
    current_sensor_line.CAUSE,
    sampling_delay.CAUSE,
    lost_samples.CAUSE,
)
# That a search may select: samples that were lost are counted, and some causes no recording shows.
SEARCHED = tuple(cause for cause in CATALOGUE if cause.detector != "gaps" and not cause.not_testable)
BY_NAME = {cause.name: cause for cause in (*CATALOGUE, *CURVES, *STATED)}
# (place of an offset, place of its wander) for each offset that may wander.
OFFSETS = tuple((cause.strength.index, shape.index) for cause in CATALOGUE for shape in cause.shapes if shape.walks)


_NEUTRAL = np.zeros(PLACES)
for _parameter in (parameter for cause in CATALOGUE for parameter in cause.parameters):
    _NEUTRAL[_parameter.index] = _parameter.neutral


def neutral() -> NDArray[np.float64]:
    """The vector c of the paper's model, shape (PLACES,)."""
    return _NEUTRAL.copy()


def with_trait(trait: Trait) -> frozenset[str]:
    """The names of the causes of that trait."""
    return frozenset(cause.name for cause in CATALOGUE if trait in cause.traits)


def cause_of_detector(detector: Detector) -> Cause:
    """The cause that has a search of its own."""
    # Unpacked: for a detector of several causes this fails, where a search for the first would take any of them.
    (cause,) = (cause for cause in CATALOGUE if cause.detector == detector)
    return cause


def measurement_for(name: str, confounder: str) -> str:
    """The measurement with other instruments that tells two causes apart; without one, how to confirm each by hand."""
    cause, other = BY_NAME[name], BY_NAME[confounder]
    # Written down once, at either of the two.
    known = cause.deciding_measurements.get(confounder) or other.deciding_measurements.get(name)
    return known or f"for {name}: {cause.confirm}; for {confounder}: {other.confirm}"
