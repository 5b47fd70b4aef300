"""The curves of the extended model: cubic B-splines over a range, which fade outside it and are absent without one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from twin.model.causes import curve
from twin.model.causes.catalogue import CATALOGUE, neutral
from twin.model.extended import (
    Base,
    acceleration,
    current_of_reading,
    current_reading,
    drive,
    position_of_reading,
    position_reading,
)

CE152 = Base(K_A=0.3, T_A=0.02, K_c=3e-6, b=0.02, mass_kg=0.0084, gravity_m_s2=9.81, x_max_m=6e-3, travel_m=5e-3)
LOW, HIGH = 1e-3, 4e-3


def having(index: int, k: NDArray[np.float64], low: float = LOW, high: float = HIGH) -> NDArray[np.float64]:
    """The vector c with one curve."""
    c = neutral()
    c[index], c[index + 1], c[index + 2 : index + 2 + len(k)] = low, high, k
    return c


def test_a_curve_is_the_b_spline_of_its_coefficients() -> None:
    k = np.random.default_rng(1).normal(size=curve.COEFFICIENTS)
    knots = LOW + (HIGH - LOW) * np.arange(-3, curve.COEFFICIENTS + 1) / (curve.COEFFICIENTS - 3)
    at = np.linspace(LOW, HIGH, 57)[:-1]

    values = [curve.value(having(curve.PULL_OVER_X, k), curve.PULL_OVER_X, x) for x in at]

    np.testing.assert_allclose(values, BSpline(knots, k, 3)(at), atol=1e-12)


def test_the_slope_of_a_curve_is_that_of_its_b_spline() -> None:
    k = np.random.default_rng(2).normal(size=curve.COEFFICIENTS)
    knots = LOW + (HIGH - LOW) * np.arange(-6, curve.COEFFICIENTS + 4) / (curve.COEFFICIENTS - 3)
    whole = BSpline(knots, np.pad(k, 3), 3).derivative()
    knot = (HIGH - LOW) / (curve.COEFFICIENTS - 3)
    at = np.linspace(LOW - 2.9 * knot, HIGH + 2.9 * knot, 101)

    slopes = [curve.slope(having(curve.PULL_OVER_X, k), curve.PULL_OVER_X, x) for x in at]

    np.testing.assert_allclose(slopes, whole(at), atol=1e-9 / (HIGH - LOW))
    assert curve.slope(having(curve.PULL_OVER_X, k), curve.PULL_OVER_X, HIGH + 3.0 * knot) == 0.0
    assert curve.slope(having(curve.PULL_OVER_X, k, 0.0, 0.0), curve.PULL_OVER_X, HIGH) == 0.0


@given(
    k=st.lists(st.floats(-0.06, 0.06), min_size=curve.COEFFICIENTS, max_size=curve.COEFFICIENTS),
    share=st.floats(0.0, 1.0),
)
def test_the_reading_of_a_sensor_with_a_curve_is_undone(k: list[float], share: float) -> None:
    c, x = having(curve.SENSOR_OVER_X, np.array(k)), share * CE152.travel_m

    assert position_of_reading(CE152, c, position_reading(CE152, c, x, 0.6), 0.6) == pytest.approx(x, abs=1e-8)


@given(
    k=st.lists(st.floats(-0.03, 0.03), min_size=curve.COEFFICIENTS, max_size=curve.COEFFICIENTS),
    i=st.floats(0.0, 1.5),
)
def test_the_reading_of_a_current_sensor_with_a_curve_is_undone(k: list[float], i: float) -> None:
    c = having(curve.READING_OVER_I, np.array(k), 0.3, 1.2)

    assert current_of_reading(c, current_reading(c, i)) == pytest.approx(i, abs=1e-6)


def test_outside_its_range_a_curve_fades_to_nothing_without_a_jump() -> None:
    c = having(curve.FORCE_OVER_X, np.full(curve.COEFFICIENTS, 0.3))
    knot = (HIGH - LOW) / (curve.COEFFICIENTS - 3)
    fading = [curve.value(c, curve.FORCE_OVER_X, HIGH + share * knot) for share in np.linspace(0.0, 3.0, 61)]

    assert curve.value(c, curve.FORCE_OVER_X, 0.5 * (LOW + HIGH)) == pytest.approx(0.3)
    assert fading[0] == pytest.approx(0.3)
    assert np.all(np.diff(fading) <= 0.0)
    assert np.max(-np.diff(fading)) < 0.02
    assert fading[-1] == 0.0
    assert curve.value(c, curve.FORCE_OVER_X, LOW - 3.0 * knot) == 0.0
    assert curve.value(c, curve.FORCE_OVER_X, 1e9) == 0.0


def test_a_curve_without_a_range_is_exactly_absent() -> None:
    k = np.full(curve.COEFFICIENTS, 0.3)
    for cause in curve.CURVES:
        c = having(cause.parameters[0].index, k, 0.0, 0.0)
        assert drive(CE152, c, 2.0, 0.0) == drive(CE152, neutral(), 2.0, 0.0)
        assert acceleration(CE152, c, 0.6, 2e-3, 0.1, 0.0) == acceleration(CE152, neutral(), 0.6, 2e-3, 0.1, 0.0)
        assert position_reading(CE152, c, 2e-3, 0.6) == position_reading(CE152, neutral(), 2e-3, 0.6)
        assert current_reading(c, 0.6) == current_of_reading(c, 0.6) == 0.6


def test_each_curve_is_a_share_of_what_its_text_says() -> None:
    k, i, x, v, u = np.full(curve.COEFFICIENTS, 0.1), 0.6, 2e-3, 0.05, 2.0
    plain, p = neutral(), CE152
    weight = p.gravity_m_s2
    pull = acceleration(p, plain, i, x, v, 0.0) + weight + p.b * v / p.mass_kg

    def change(index: int, low: float, high: float) -> float:
        return acceleration(p, having(index, k, low, high), i, x, v, 0.0) - acceleration(p, plain, i, x, v, 0.0)

    assert change(curve.FORCE_OVER_X, 0.0, 5e-3) == pytest.approx(0.1 * weight)
    assert change(curve.FORCE_OVER_V, -1.0, 1.0) == pytest.approx(0.1 * weight)
    assert change(curve.DRAG_OVER_X, 0.0, 5e-3) == pytest.approx(-0.1 * weight * v / 0.1)
    assert change(curve.PULL_OVER_X, 0.0, 5e-3) == pytest.approx(0.1 * pull)
    assert change(curve.PULL_OVER_I, 0.0, 2.0) == pytest.approx(0.1 * pull)
    i_0 = np.sqrt(p.mass_kg * p.gravity_m_s2 / p.K_c) * (p.x_max_m - 0.5 * p.travel_m)
    driven = drive(p, having(curve.DRIVE_OVER_U, k, 0.0, 5.0), u, 0.0) - drive(p, plain, u, 0.0)
    assert driven == pytest.approx(0.1 * i_0)
    shift = position_reading(p, having(curve.SENSOR_OVER_X, k, 0.0, 5e-3), x, i) - x
    assert shift == pytest.approx(0.1 * p.travel_m)
    assert current_reading(having(curve.READING_OVER_I, k, 0.0, 2.0), i) == pytest.approx(1.1 * i)


def test_a_curve_is_no_entry_of_the_catalogue() -> None:
    assert {item.name for item in curve.CURVES}.isdisjoint(cause.name for cause in CATALOGUE)
