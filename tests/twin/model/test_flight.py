"""A step in flight against an adaptive solver and against Runge-Kutta."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.estimation.record import FloatArray
from twin.model.causes import (
    amplifier_gain_drift,
    constant_force,
    core_saturation,
    current_sensor_lag,
    curve,
    eddy_current_lag,
    force_exponent,
    freewheel_diode,
    magnetic_hysteresis,
    periodic_disturbance,
    quadratic_drag,
    residual_magnetism,
    second_time_constant,
    slew_rate_limit,
)
from twin.model.causes.catalogue import neutral
from twin.model.extended import (
    CORE,
    FIELD,
    I_C,
    I_SENSOR,
    LOOP,
    SECOND,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    acceleration,
    drive,
    feels_ball,
    settle_current,
)
from twin.model.flight import fly
from twin.model.integration import over

CAUSES = {
    "paper": {},
    "drag": {quadratic_drag.C: 1.0},
    "exponent": {force_exponent.N: 1.7, force_exponent.BEND: 0.5},
    "saturation": {core_saturation.I_S: 1.0, core_saturation.KNEE: 1.5},
    "shaking": {periodic_disturbance.AMPLITUDE: 0.01, periodic_disturbance.FREQUENCY: 50.0},
    "offsets": {residual_magnetism.I_R: 0.05, constant_force.FORCE: 0.01},
    "curves": {
        curve.PULL_OVER_X: 0.0, curve.PULL_OVER_X + 1: 6e-3, curve.PULL_OVER_X + 4: 0.2,
        curve.PULL_OVER_I: 0.0, curve.PULL_OVER_I + 1: 1.5, curve.PULL_OVER_I + 5: 0.2,
    },
}  # fmt: skip

LAGS = {
    "second time constant": {second_time_constant.SHARE: 0.3, second_time_constant.TAU: 2e-3},
    "slew rate": {slew_rate_limit.RATE: 200.0},
    "slew rate and second time constant": {slew_rate_limit.RATE: 300.0, second_time_constant.SHARE: 0.2},
    "diode": {freewheel_diode.DROP: 1.5},
    "field": {eddy_current_lag.TAU: 1e-3},
    "power of the field": {eddy_current_lag.TAU: 1e-3, eddy_current_lag.ORDER: 2.0},
    "two fields": {eddy_current_lag.TAU: 1e-3, eddy_current_lag.SLOW: 0.3, eddy_current_lag.TIMES: 10.0},
    "loop": {magnetic_hysteresis.HALF_WIDTH: 0.05, magnetic_hysteresis.TURN: 0.1},
    "sensor and saturation": {current_sensor_lag.TAU: 1e-3, core_saturation.I_S: 1.0},
}


def paper(T_A: float = 3e-4) -> Base:
    return Base(
        K_A=0.297, T_A=T_A, K_c=2.751e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=5.7e-3, travel_m=5.7e-3
    )


def vector(values: dict[int, float]) -> FloatArray:
    c = neutral()
    for index, value in values.items():
        c[index] = value
    return c


def exact(p: Base, c: FloatArray, y: FloatArray, before: float, change: float, u: float, T_s: float) -> FloatArray:
    """Current, position and speed at the end by an adaptive solver, in two pieces."""
    z = y[[I_C, X, V]]
    for begin, end, held in ((0.0, change, before), (change, T_s, u)):
        if end > begin:
            target = drive(p, c, held, y[WARMTH])

            def right(t: float, z: FloatArray, target: float = target) -> list[float]:
                return [(target - z[0]) / p.T_A, z[2], acceleration(p, c, z[0], z[1], z[2], t)]

            z = solve_ivp(right, (begin, end), z, method="LSODA", rtol=1e-11, atol=1e-14).y[:, -1]
    return np.asarray(z)


def random_flight(draw: np.random.Generator, p: Base, T_s: float) -> tuple[FloatArray, float, float, float]:
    """A state off the equilibrium, u_c before and after its change, and the time of the change."""
    gap = draw.uniform(1.5e-3, 5e-3)
    held = math.sqrt(p.mass_kg * p.gravity_m_s2 / p.K_c) * gap
    y = np.zeros(STATES)
    y[I_C], y[X], y[V] = held * draw.uniform(0.7, 1.3), p.x_max_m - gap, draw.uniform(-0.1, 0.1)
    y[FIELD] = y[I_C]
    before, u = held * draw.uniform(0.5, 1.5, 2) / p.K_A
    return y, float(before), float(u), float(draw.choice([0.0, draw.uniform(0.0, T_s)]))


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("T_s", [5e-4, 2e-3, 5e-3])
def test_a_step_is_as_exact_as_runge_kutta(cause: str, T_s: float) -> None:
    draw, c = np.random.default_rng(20), vector(CAUSES[cause])
    flown, stepped = [], []

    for T_A in (1e-4, 3e-4, 2e-3, 3e-2) * 4:
        p = paper(T_A)
        y, before, u, change = random_flight(draw, p, T_s)
        y_steps = y.copy()
        want = exact(p, c, y, before, change, u, T_s)
        fly(tuple(p), c, y, before, change, u, 0.0, T_s)
        over(tuple(p), c, y_steps, before, 0.0, change, False)
        over(tuple(p), c, y_steps, u, change, T_s - change, False)
        flown.append(np.abs(y[[I_C, X, V]] - want))
        stepped.append(np.abs(y_steps[[I_C, X, V]] - want))

    errors, step_errors = np.max(flown, axis=0), np.max(stepped, axis=0)
    assert errors[0] < 1e-9
    assert errors[1] < 1.5 * step_errors[1] + 5e-9
    assert errors[2] < 1.5 * step_errors[2] + 1e-5
    assert errors[1] < 2e-7


@pytest.mark.parametrize("cause", LAGS)
def test_a_step_with_lags_is_as_exact_as_runge_kutta(cause: str) -> None:
    """The reference is Runge-Kutta in steps of 10 us."""
    draw, c, T_s = np.random.default_rng(21), vector(LAGS[cause]), 2e-3
    states = [I_C, FIELD, CORE, LOOP, SECOND, I_SENSOR, X, V]
    assert not feels_ball(c)
    flown, stepped = [], []

    for T_A in (1e-4, 3e-4, 2e-3, 3e-2) * 6:
        p = paper(T_A)
        y, before, u, change = random_flight(draw, p, T_s)
        settle_current(c, y, y[I_C])
        y[LOOP] = draw.uniform(-0.9, 0.9)
        y_steps, want = y.copy(), y.copy()
        fly(tuple(p), c, y, before, change, u, 0.0, T_s)
        for held, begin, end in ((before, 0.0, change), (u, change, T_s)):
            over(tuple(p), c, y_steps, held, begin, end - begin, False)
            count = math.ceil((end - begin) / 1e-5)
            for _ in range(count):
                over(tuple(p), c, want, held, begin, (end - begin) / count, False)
        flown.append(np.abs(y - want)[states])
        stepped.append(np.abs(y_steps - want)[states])

    errors, step_errors = np.max(flown, axis=0), np.max(stepped, axis=0)
    np.testing.assert_array_less(errors, 1.5 * step_errors + [*[1e-9] * 6, 5e-9, 1e-5])
    assert errors[-2] < 2e-7


def test_a_change_of_the_input_within_a_step_is_two_steps() -> None:
    p, c = paper(), neutral()
    y, before, u, _ = random_flight(np.random.default_rng(3), p, 2e-3)
    split = y.copy()

    fly(tuple(p), c, y, before, 7e-4, u, 0.0, 2e-3)
    fly(tuple(p), c, split, before, 7e-4, before, 0.0, 7e-4)
    fly(tuple(p), c, split, u, 0.0, u, 7e-4, 1.3e-3)

    assert y[I_C] == pytest.approx(split[I_C], rel=1e-12)
    assert y[X] == pytest.approx(split[X], abs=1e-8)
    assert y[V] == pytest.approx(split[V], abs=1e-5)


def test_the_warmth_follows_the_mean_square_of_the_current() -> None:
    p, c = paper(), vector({amplifier_gain_drift.LOSS: 0.01, amplifier_gain_drift.TAU: 1.0})
    y = np.zeros(STATES)
    y[I_C], y[X] = 0.5, 2e-3

    fly(tuple(p), c, y, 0.0, 0.0, 0.0, 0.0, 2e-3)

    mean = 0.25 * 0.5 * p.T_A * (1.0 - math.exp(-2.0 * 2e-3 / p.T_A))  # of i_c^2 over T_s, over tau = 1 s
    assert y[WARMTH] == pytest.approx(mean, rel=0.01)


def test_an_interval_of_no_length_changes_nothing() -> None:
    p, c = paper(), neutral()
    y, before, u, _ = random_flight(np.random.default_rng(3), p, 2e-3)
    old = y.copy()

    fly(tuple(p), c, y, before, 0.0, u, 0.0, 0.0)

    assert np.array_equal(y, old)
