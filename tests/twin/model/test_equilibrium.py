"""Tests of where the ball can rest, with whatever causes there are."""

from __future__ import annotations

import math

import pytest

from protocol.campaign import Controller
from tests.harness.diagnose.simulated_rig import PLANT, THETA, strong
from twin.diagnosis.experiments.designed_law import law_of
from twin.inference.theta import Theta
from twin.model.causes.cause import Vector
from twin.model.equilibrium import at_rest, holding_current, holding_input, steady_current
from twin.model.extended import Base


def kernels(theta: Theta) -> tuple[Base, Vector]:
    return theta.base(PLANT), theta.vector()


def test_rest_is_where_forces_balance() -> None:
    weight = PLANT.mass_kg * PLANT.gravity_m_s2
    for x in (0.0, 2e-3, 5e-3):
        i = holding_current(*kernels(THETA), x)

        assert THETA.K_c * i**2 / (PLANT.x_max_m - x) ** 2 == pytest.approx(weight, rel=1e-14)
        assert holding_input(*kernels(THETA), i) == pytest.approx(i / THETA.K_A, rel=1e-14)
        assert steady_current(*kernels(THETA), i / THETA.K_A) == pytest.approx(i, rel=1e-9)


def test_a_coil_settles_where_its_amplifier_leaves_it() -> None:
    # A diode brakes what flows above the current of rest, not that itself.
    assert steady_current(*kernels(strong("freewheel-diode", 0.5)), 0.4) == pytest.approx(0.4 * THETA.K_A, rel=1e-6)
    warm = steady_current(*kernels(strong("amplifier-gain-drift", 0.05)), 2.0)
    assert warm == pytest.approx(2.0 * THETA.K_A * (1.0 - 0.05 * warm**2), rel=1e-6)


def test_what_the_amplifier_cannot_give_is_no_rest() -> None:
    p, c = kernels(strong("current-limit", 0.5))

    y, u = at_rest(p, c, 0.0)

    assert math.isnan(holding_input(p, c, 0.6))
    assert math.isnan(u) == (y[0] > 0.5)


def test_of_two_inputs_under_a_limit_that_folds_back_the_lower_one_holds() -> None:
    p, c = kernels(strong("current-limit", 1.0).having("current-limit.fold", 0.3))

    assert holding_input(p, c, 0.5) == pytest.approx(0.5 / THETA.K_A, rel=1e-12)


def test_a_current_below_that_of_no_input_has_no_input() -> None:
    p, c = kernels(strong("amplifier-offset", 0.5))  # A

    assert math.isnan(holding_input(p, c, 0.4))
    assert holding_input(p, c, 0.6) == pytest.approx(0.1 / THETA.K_A, rel=1e-12)


def test_what_is_shown_is_what_the_sensor_shows() -> None:
    p, c = kernels(strong("sensor-crosstalk", 1e-4))

    y, u = at_rest(p, c, 2e-3, as_reading=True)

    assert y[4] == pytest.approx(2e-3, abs=1e-12)
    assert abs(y[1] - 2e-3) > 1e-5  # the crosstalk of the current that holds the ball
    assert holding_current(p, c, float(y[1])) == pytest.approx(y[0], rel=1e-12)
    assert holding_input(p, c, float(y[0])) == pytest.approx(u, rel=1e-14)


def test_a_ball_that_nothing_can_hold_has_no_rest() -> None:
    p, c = kernels(strong("constant-force", 2.0 * PLANT.mass_kg * PLANT.gravity_m_s2))  # it falls upwards

    y, u = at_rest(p, c, 2e-3)

    assert math.isnan(holding_current(p, c, 2e-3))
    assert math.isnan(u)
    assert y[0] == 0.0


def test_a_law_for_a_rig_that_cannot_be_held_does_nothing() -> None:
    rig = strong("constant-force", 2.0 * PLANT.mass_kg * PLANT.gravity_m_s2)
    none: Controller | None = None

    numbers = law_of(none, rig, PLANT, 2e-3, 5.0)

    assert (numbers.k_i, numbers.k_x, numbers.k_v, numbers.k_s, numbers.u_0) == (0.0, 0.0, 0.0, 0.0, 0.0)
