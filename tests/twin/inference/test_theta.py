"""The coordinates of the parameters: what moves together."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.harness.diagnose.simulated_rig import PLANT, THETA, criterion_of, fitted, narrow, strong
from twin.inference.theta import Theta, moved
from twin.model.causes.catalogue import BY_NAME
from twin.model.extended import position_reading

DECADES = [
    f"{cause.name}.{parameter.name}"
    for cause in BY_NAME.values()
    for parameter in cause.parameters
    if parameter.logarithmic
]

SENSING = {
    "position-sensor-gain": 0.95,
    "position-sensor-offset": 2e-4,
    "position-sensor-nonlinearity": 1e-4,
}


def rests(theta: Theta) -> list[float]:
    """The readings at both stops, m."""
    stops = theta.stop_low_m, PLANT.travel_m + theta.stop_high_m
    return [float(position_reading(theta.base(PLANT), theta.vector(), stop, 0.0)) for stop in stops]


@pytest.mark.parametrize(("cause", "value"), SENSING.items())
def test_with_an_error_of_the_sensor_the_stops_move_so_that_the_readings_at_rest_stay(cause: str, value: float) -> None:
    theta = strong(cause, value, replace(THETA, stop_low_m=1e-5, stop_high_m=-3e-5))
    strength = next(name for name, _ in theta.causes if name.startswith(cause))

    for other in (moved(theta, strength, 3.0, PLANT), theta.without(cause, PLANT)):
        assert rests(other) == pytest.approx(rests(theta), abs=1e-12)
        assert other.stop_high_m != theta.stop_high_m


def test_a_cause_elsewhere_moves_no_stop() -> None:
    theta = strong("air-gap-offset", 1e-4, replace(THETA, stop_low_m=1e-5, stop_high_m=-3e-5))

    for other in (moved(theta, "air-gap-offset.d_m", 3.0, PLANT), theta.without("air-gap-offset", PLANT)):
        assert (other.stop_low_m, other.stop_high_m) == (theta.stop_low_m, theta.stop_high_m)


@pytest.mark.parametrize("cause", SENSING)
def test_a_coordinate_at_its_bound_moves_nothing(cause: str) -> None:
    strength = BY_NAME[cause].strength
    theta = strong(cause, strength.high, replace(THETA, stop_low_m=1e-5, stop_high_m=-3e-5))

    moves = [moved(theta, f"{cause}.{strength.name}", step, PLANT) == theta for step in (1.0, -1.0)]

    assert sorted(moves) == [False, True]


@pytest.mark.parametrize("name", DECADES)
def test_what_may_lie_anywhere_within_decades_moves_by_a_factor_and_ends_at_its_bounds(name: str) -> None:
    cause, _, parameter = name.partition(".")
    known = next(entry for entry in BY_NAME[cause].parameters if entry.name == parameter)
    theta = THETA.having(name, math.sqrt(known.low * known.high))

    factors = {moved(theta.having(name, v), name, 1.0, PLANT).value(name) / v for v in (2 * known.low, known.high / 2)}

    assert max(factors) == pytest.approx(min(factors))
    assert [moved(theta, name, step, PLANT).value(name) for step in (-99.0, 9999.0)] == [known.low, known.high]
    for bound, step in ((known.low, -1.0), (known.high, 1.0)):
        assert moved(theta.having(name, bound), name, step, PLANT).value(name) == bound


@pytest.mark.slow
def test_a_time_constant_a_hundred_times_the_usual_one_is_reached() -> None:
    share, tau_s = 0.1, 0.6
    creeping = strong("second-time-constant", share).having("second-time-constant.tau_s", tau_s)
    criterion = criterion_of(narrow(creeping, seconds=10.0))
    try:
        fit = fitted(criterion, strong("second-time-constant", 0.3 * share), "second-time-constant")
        truth = criterion.value(creeping)
    finally:
        criterion.close()

    assert fit.converged
    assert fit.loglik > truth
    assert fit.theta.value("second-time-constant.tau_s") == pytest.approx(tau_s, rel=0.05)
