"""The forms of each effect, against the formulas of the literature and an adaptive solver."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from twin.estimation.record import FloatArray
from twin.model.causes import (
    amplifier_dead_zone,
    amplifier_gain_drift,
    core_saturation,
    coulomb_friction,
    current_limit,
    current_sensor_lag,
    eddy_current_lag,
    force_exponent,
    motional_emf,
    position_dependent_inductance,
    position_sensor_lag,
    quadratic_drag,
    second_time_constant,
)
from twin.model.causes.catalogue import CATALOGUE, neutral
from twin.model.causes.cause import Cause
from twin.model.extended import (
    CORE,
    FIELD,
    I_C,
    I_SENSOR,
    RATE,
    SECOND,
    SENSOR,
    STATES,
    Base,
    V,
    X,
    lasting_warmth,
    reading_of_current,
)
from twin.model.integration import advance

RIG = Base(K_A=0.3, T_A=0.3e-3, K_c=6e-6, b=0.02, mass_kg=8.28e-3, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
MID_M = RIG.x_max_m - 0.5 * RIG.travel_m
GAPS = np.linspace(2.4e-3, 8.1e-3, 12)
TICK_S, TICKS, START_A, START_M, INPUT_V = 2e-3, 5, 0.57, 3e-3, 2.1
SHAPED = [cause for cause in CATALOGUE if cause.shapes]


def having(**places: float) -> FloatArray:
    """The neutral vector with these places changed, `p7=..` for place 7."""
    c = neutral()
    for key, value in places.items():
        c[int(key[1:])] = value
    return c


@pytest.mark.parametrize("cause", SHAPED, ids=lambda cause: cause.name)
def test_a_form_names_shapes_within_their_range(cause: Cause) -> None:
    shapes = {item.name: item for item in cause.shapes}

    assert cause.usual
    assert cause.strength.name not in shapes
    for form in cause.forms:
        assert form.source
        assert cause.strength.name not in form.values
        assert set(form.values) & set(shapes)
        for name, value in form.values.items():
            parameter = next(item for item in cause.parameters if item.name == name)
            if isinstance(value, str):
                assert value in {item.name for item in cause.parameters}
                continue
            assert parameter.low <= value <= parameter.high
            if name in shapes:
                assert abs(value - shapes[name].neutral) <= 4.0 * shapes[name].spread


@pytest.mark.parametrize(
    "cause", [item for item in SHAPED if item.name != "force-exponent"], ids=lambda cause: cause.name
)
def test_a_shape_without_its_strength_does_nothing(cause: Cause) -> None:
    """But for the gap law, whose power in the middle may be that of (3) although it is another elsewhere."""
    c = neutral()
    for shape in cause.shapes:
        c[shape.index] = min(shape.neutral + shape.spread, shape.high)
    states = []
    for vector in (neutral(), c):
        y = np.zeros(STATES)
        y[I_C], y[X], y[V], y[FIELD], y[SENSOR] = START_A, START_M, 0.05, START_A, START_M
        for tick in range(TICKS):
            advance(tuple(RIG), vector, y, INPUT_V, tick * TICK_S, TICK_S, False)
        states.append(y)

    assert states[0].tolist() == states[1].tolist()


@given(i_s=st.floats(0.5, 20.0), knee=st.floats(0.7, 8.0))
def test_at_i_s_the_force_is_half_of_what_i_squared_says(i_s: float, knee: float) -> None:
    c = having(p11=i_s, p31=knee)

    assert core_saturation.field(c, i_s) ** 2 == pytest.approx(0.5 * i_s**2, rel=1e-12)


@given(i_s=st.floats(0.5, 20.0), i=st.floats(0.0, 2.0))
def test_a_knee_of_1_is_froehlich_s(i_s: float, i: float) -> None:
    half = i_s / (math.sqrt(2.0) - 1.0)

    assert core_saturation.field(having(p11=i_s, p31=1.0), i) == pytest.approx(i / (1.0 + i / half), rel=1e-12)


def test_the_gap_law_holds_a_power_and_an_exponential() -> None:
    length_m = 2e-3
    for gap in GAPS:
        power = force_exponent.factor(having(p10=2.6), gap, MID_M) / gap**2
        assert power * MID_M**2 == pytest.approx((MID_M / gap) ** 2.6, rel=1e-12)
        m = MID_M / length_m
        exponential = force_exponent.factor(having(p10=m, p35=m), gap, MID_M) / gap**2
        assert exponential * MID_M**2 == pytest.approx(math.exp((MID_M - gap) / length_m), rel=1e-12)


@given(n=st.floats(0.5, 4.0), q=st.floats(-3.0, 3.0), p=st.floats(-3.0, 3.0), r=st.floats(0.4, 1.6))
def test_the_power_at_each_gap_is_as_its_equation_says(n: float, q: float, p: float, r: float) -> None:
    c, h = having(p10=n, p35=q, p45=p), 1e-4

    def log_force(r: float) -> float:
        return math.log(force_exponent.factor(c, r * MID_M, MID_M)) - 2.0 * math.log(r)

    slope = (log_force(r * (1.0 + h)) - log_force(r * (1.0 - h))) / (math.log(1.0 + h) - math.log(1.0 - h))
    assert -slope == pytest.approx(n + q * (r - 1.0) + p * (r - 1.0) ** 2, abs=1e-6)


@given(target=st.floats(0.0, 3.0), limit=st.floats(0.5, 1.5), power=st.floats(2.0, 40.0))
def test_a_soft_knee_is_rapp_s_limiter(target: float, limit: float, power: float) -> None:
    current = current_limit.aimed_at(having(p2=limit, p32=1.0 / power), target)

    assert current == pytest.approx(target / (1.0 + (target / limit) ** power) ** (1.0 / power), rel=1e-9)
    assert current <= min(target, limit) * (1.0 + 1e-15)  # a root that is rounded


def test_foldback_gives_less_the_more_is_asked_for() -> None:
    c = having(p2=1.0, p46=0.3)

    assert [current_limit.aimed_at(c, target) for target in (0.5, 1.0, 1.4)] == pytest.approx([0.5, 1.0, 0.88])


@given(width=st.floats(0.01, 1.0), rounding=st.floats(0.01, 1.5), u=st.floats(0.0, 5.0))
def test_a_rounded_dead_zone_starts_at_0_rises_and_ends_on_its_line(width: float, rounding: float, u: float) -> None:
    c = having(p4=width, p33=rounding)

    assert amplifier_dead_zone.effective_input(c, 0.0) == 0.0
    assert amplifier_dead_zone.effective_input(c, u + 0.01) > amplifier_dead_zone.effective_input(c, u) >= 0.0
    far = amplifier_dead_zone.effective_input(c, 1e4 + 1.0) - amplifier_dead_zone.effective_input(c, 1e4)
    assert far == pytest.approx(1.0, abs=1e-6)


def test_an_inductance_of_short_reach_is_woodson_s() -> None:
    """L = L_inf + L_1 / (1 + gap / a) with a as far as the middle gap, and the voltage of its slope."""
    growth, a = 1.5, MID_M
    bottom, mid = RIG.x_max_m, MID_M

    def part(gap: float) -> float:
        return 1.0 / (1.0 + gap / a)

    for gap in GAPS:
        c = having(p6=growth, p38=1.0)
        time_constant = position_dependent_inductance.time_constant(c, RIG.T_A, gap, bottom, mid)
        expected = RIG.T_A * (1.0 + growth * (part(gap) - part(bottom)) / (part(mid) - part(bottom)))
        assert time_constant == pytest.approx(expected, rel=1e-12)
        voltage = motional_emf.per_speed(having(p7=0.1, p39=1.0), gap, mid)
        assert voltage == pytest.approx(0.1 * (part(gap) / part(mid)) ** 2, rel=1e-12)
        belongs = position_dependent_inductance.per_speed(
            having(p6=growth, p38=1.0, p43=1.0), RIG.T_A, gap, bottom, mid
        )
        slope = (part(gap - 1e-9) - part(gap + 1e-9)) / 2e-9 / (part(mid) - part(bottom))
        assert belongs == pytest.approx(RIG.T_A * growth * slope, rel=1e-5)


def test_friction_after_stribeck_is_more_at_rest_and_less_when_fast() -> None:
    c, m = having(p15=4e-3, p41=0.5, p40=0.01), RIG.mass_kg

    assert coulomb_friction.brakes(c, m, 0.0, 5.9e-3 / m) == 0.0  # held
    assert coulomb_friction.brakes(c, m, 0.0, 6.1e-3 / m) == pytest.approx(6e-3 / m)
    assert coulomb_friction.brakes(c, m, -0.01, 0.0) == pytest.approx(-4e-3 / m * (1.0 + 0.5 * math.exp(-1.0)))
    assert coulomb_friction.brakes(c, m, 1.0, 0.0) == pytest.approx(4e-3 / m)


def test_drag_of_another_power_has_the_same_size_at_a_tenth_of_a_metre_per_second() -> None:
    for power in (1.5, 2.0, 3.0):
        c = having(p14=0.5, p36=power)
        assert quadratic_drag.drag_n(c, -0.1) == pytest.approx(-0.5 * 0.01)
        assert quadratic_drag.drag_n(c, 0.2) == pytest.approx(0.5 * 0.01 * 2.0**power)


def after(c: FloatArray, ticks: int) -> FloatArray:
    """The state after so many ticks, the input stepped at the first."""
    y = np.zeros(STATES)
    y[I_C], y[X], y[V], y[FIELD], y[SENSOR] = START_A, START_M, 0.05, START_A, START_M
    y[RATE], y[SECOND], y[CORE], y[I_SENSOR] = 0.05, START_A, START_A, START_A
    for tick in range(ticks):
        advance(tuple(RIG), c, y, INPUT_V, tick * TICK_S, TICK_S, False)
    return y


def solved(right: Callable[[float, FloatArray], list[float]], start: list[float], ticks: int) -> FloatArray:
    solution = solve_ivp(right, (0.0, ticks * TICK_S), start, method="LSODA", rtol=1e-11, atol=1e-14)
    return np.asarray(solution.y[:, -1])


@pytest.mark.parametrize("ticks", [1, 5])
@pytest.mark.parametrize(("flux", "order"), [(0.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.7, 1.6)])
def test_what_eddy_currents_hold_back_is_current_flux_or_force(flux: float, order: float, ticks: int) -> None:
    tau = 1.5e-3

    def held(i: float, x: float) -> float:
        return float((i / (RIG.x_max_m - x) ** flux) ** order)

    def right(_: float, z: FloatArray) -> list[float]:
        i, x, v, slow = z
        gap = RIG.x_max_m - x
        force = RIG.K_c * slow ** (2.0 / order) * gap ** (2.0 * flux - 2.0) - RIG.b * v
        current = (RIG.K_A * INPUT_V - i) / RIG.T_A
        return [current, v, force / RIG.mass_kg - RIG.gravity_m_s2, (held(i, x) - slow) / tau]

    truth = solved(right, [START_A, START_M, 0.05, held(START_A, START_M)], ticks)
    y = after(having(p13=tau, p34=flux, p37=order), ticks)

    assert eddy_current_lag.TAU == 13
    assert y[X] == pytest.approx(truth[1], abs=2e-7)
    assert y[V] == pytest.approx(truth[2], abs=1e-4)


@pytest.mark.parametrize("ticks", [1, 5])
def test_a_solid_core_has_two_time_constants_and_tau_is_their_mean(ticks: int) -> None:
    tau, share, times = 2e-3, 0.4, 8.0
    quick = tau / (1.0 - share + share * times)

    def right(_: float, z: FloatArray) -> list[float]:
        i, x, v, fast, slow = z
        field = (1.0 - share) * fast + share * slow
        force = RIG.K_c * field**2 / (RIG.x_max_m - x) ** 2 - RIG.b * v
        current = (RIG.K_A * INPUT_V - i) / RIG.T_A
        lags = [(i - fast) / quick, (i - slow) / (times * quick)]
        return [current, v, force / RIG.mass_kg - RIG.gravity_m_s2, *lags]

    truth = solved(right, [START_A, START_M, 0.05, START_A, START_A], ticks)
    y = after(having(p13=tau, p125=share, p126=times), ticks)

    assert (eddy_current_lag.SLOW, eddy_current_lag.TIMES) == (125, 126)
    assert y[X] == pytest.approx(truth[1], abs=2e-7)
    assert y[V] == pytest.approx(truth[2], abs=1e-4)


@pytest.mark.parametrize("ticks", [1, 5])
@pytest.mark.parametrize(("share", "tau", "growth"), [(0.3, 8e-3, 0.0), (-0.2, 0.1, 0.0), (0.3, 8e-3, 0.5)])
def test_a_share_of_the_current_has_a_time_constant_of_its_own(
    share: float, tau: float, growth: float, ticks: int
) -> None:
    """Also where the inductance grows: T_A is then that of the moment."""

    def right(_: float, z: FloatArray) -> list[float]:
        i, x, v, second = z
        c = having(p6=growth, p43=0.0)
        plane, gap_mid = RIG.x_max_m, RIG.x_max_m - 0.5 * RIG.travel_m
        T_A = position_dependent_inductance.time_constant(c, RIG.T_A, plane - x, plane, gap_mid) if growth else RIG.T_A
        target = RIG.K_A * INPUT_V
        pull = share * (1.0 - T_A / tau) * (second - target)
        force = RIG.K_c * i**2 / (RIG.x_max_m - x) ** 2 - RIG.b * v
        return [(target + pull - i) / T_A, v, force / RIG.mass_kg - RIG.gravity_m_s2, (target - second) / tau]

    truth = solved(right, [START_A, START_M, 0.05, START_A], ticks)
    y = after(having(p123=share, p124=tau, p6=growth, p43=0.0), ticks)

    assert (second_time_constant.SHARE, second_time_constant.TAU) == (123, 124)
    assert y[I_C] == pytest.approx(truth[0], abs=1e-9 if growth == 0.0 else 3e-4)
    assert y[X] == pytest.approx(truth[1], abs=2e-7)
    assert y[SECOND] == pytest.approx(truth[3], abs=1e-12)


@pytest.mark.parametrize("ticks", [1, 5])
def test_a_slow_current_sensor_shows_the_current_late_and_changes_nothing_else(ticks: int) -> None:
    tau = 1.5e-3

    def right(_: float, z: FloatArray) -> list[float]:
        i, reading = z
        return [(RIG.K_A * INPUT_V - i) / RIG.T_A, (i - reading) / tau]

    truth = solved(right, [START_A, START_A], ticks)
    c = having(p128=tau)
    y, plain = after(c, ticks), after(neutral(), ticks)

    assert current_sensor_lag.TAU == 128
    assert reading_of_current(c, y) == pytest.approx(truth[1], abs=1e-4)
    assert reading_of_current(neutral(), plain) == pytest.approx(truth[0], abs=1e-9)
    assert (y[:8] == plain[:8]).all()


@given(load=st.floats(0.5, 3.0), i=st.floats(0.0, 2.0))
def test_the_load_of_a_coil_is_a_square_and_that_of_a_supply_its_current(load: float, i: float) -> None:
    c = having(p0=0.05, p127=load)

    assert (amplifier_gain_drift.LOSS, amplifier_gain_drift.POWER) == (0, 127)
    assert lasting_warmth(c, i) == pytest.approx(i**load)
    assert lasting_warmth(having(p0=0.05), i) == pytest.approx(i * i)


@pytest.mark.parametrize("second", [0.05, 0.25, 0.5, 1.0])
def test_a_sensor_of_second_order_is_its_differential_equation(second: float) -> None:
    """Two real poles, a double one, Butterworth's, and one that swings."""
    tau = 2e-3

    def right(_: float, z: FloatArray) -> list[float]:
        i, x, v, s, rate = z
        force = RIG.K_c * i * i / (RIG.x_max_m - x) ** 2 - RIG.b * v
        turning = (x - s - tau * rate) / (second * tau * tau)
        return [
            (RIG.K_A * INPUT_V - i) / RIG.T_A,
            v,
            force / RIG.mass_kg - RIG.gravity_m_s2,
            rate,
            turning,
        ]

    truth = solved(right, [START_A, START_M, 0.05, START_M, 0.05], TICKS)
    y = after(having(p22=tau, p44=second), TICKS)

    assert position_sensor_lag.SECOND == 44
    assert y[SENSOR] == pytest.approx(truth[3], abs=5e-7)
    assert y[RATE] == pytest.approx(truth[4], abs=5e-4)
