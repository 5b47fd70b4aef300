"""Every effect of the table does to the trajectory what its formula says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest

from gateway.emulator.plant.constants import CE152, PlantConstants
from gateway.emulator.plant.effects import EFFECTS, HEATING_TIME_CONSTANT_S, MAX_DELAY_S
from gateway.emulator.plant.levitation import STEP_S, EmulatedPlant

CATALOGUE = """
amplifier-gain-drift current-limit slew-rate-limit amplifier-dead-zone amplifier-offset position-dependent-inductance
motional-emf actuation-delay air-gap-offset force-exponent core-saturation residual-magnetism eddy-current-lag
quadratic-drag coulomb-friction constant-force periodic-disturbance position-sensor-offset position-sensor-gain
position-sensor-nonlinearity position-sensor-lag sensor-crosstalk current-sensor-offset current-sensor-gain
sampling-delay lost-samples
""".split()
QUIET = replace(CE152, position_noise_m=0.0, current_noise_a=0.0)
MIDDLE_M = QUIET.travel_m / 2.0
MIDDLE_A = QUIET.equilibrium_current_a(MIDDLE_M)
WEIGHT_N = QUIET.mass_kg * QUIET.gravity_m_s2
K_A, T_A = QUIET.amplifier_gain_a_v, QUIET.amplifier_time_constant_s


def rig_with(
    rig: PlantConstants = QUIET, /, *, x_m: float = 0.0, v_m_s: float = 0.0, i_c_a: float = 0.0, **effect: float
) -> EmulatedPlant:
    """A noiseless plant, placed; keyword arguments name the effect with underscores."""
    plant = EmulatedPlant(rig, {name.replace("_", "-"): value for name, value in effect.items()})
    plant.set_state(x_m, v_m_s=v_m_s, i_c_a=i_c_a)
    return plant


def balance_current_a(x_m: float, **effect: float) -> float:
    """The current at which a ball let go at x moves neither way, found by trying."""
    low, high = 0.0, QUIET.current_max_a
    for _ in range(40):
        middle = 0.5 * (low + high)
        plant = rig_with(x_m=x_m, i_c_a=middle, **effect)
        plant.advance(middle / K_A, STEP_S)
        low, high = (low, middle) if plant.v_m_s > 0 else (middle, high)
    return 0.5 * (low + high)


def a_warm_coil_gives_less_current(loss: float) -> None:
    plant = rig_with(amplifier_gain_drift=loss)

    plant.advance(3.0, HEATING_TIME_CONSTANT_S)

    warmth = (K_A * 3.0) ** 2 * (1.0 - math.exp(-1.0))  # one time constant, i taken as its cold value
    assert 1.0 - plant.i_c_a / (K_A * 3.0) == pytest.approx(loss * warmth, rel=2.0 * loss * warmth)


def the_current_ends_at_the_limit(limit: float) -> None:
    plant = rig_with(current_limit=limit)

    plant.advance(5.0, 0.01)

    assert plant.i_c_a == pytest.approx(limit, rel=1e-9)


def the_current_rises_in_a_straight_line(rate: float) -> None:
    plant = rig_with(slew_rate_limit=rate)

    plant.advance(5.0, 0.002)
    assert plant.i_c_a == pytest.approx(rate * 0.002, rel=1e-9)

    plant.advance(0.0, 0.0001)  # the way down is limited too
    assert plant.i_c_a == pytest.approx(rate * 0.0019, rel=1e-9)


def the_dead_zone_is_missing_from_the_input(width: float) -> None:
    within, outside = rig_with(amplifier_dead_zone=width), rig_with(amplifier_dead_zone=width)

    within.advance(0.99 * width, 0.01)
    outside.advance(width + 1.0, 0.01)

    assert within.i_c_a == 0.0
    assert outside.i_c_a == pytest.approx(K_A * 1.0, rel=1e-9)


def current_flows_without_input(offset: float) -> None:
    up, down = rig_with(amplifier_offset=offset), rig_with(amplifier_offset=-offset)

    up.advance(0.0, 0.01)
    down.advance(0.0, 0.01)
    assert up.i_c_a == pytest.approx(offset, rel=1e-9)
    assert down.i_c_a == 0.0

    down.advance(2.0, 0.01)
    assert down.i_c_a == pytest.approx(K_A * 2.0 - offset, rel=1e-9)


def the_current_is_slower_near_the_coil(growth: float) -> None:
    for x_m, expected_s in ((0.0, T_A), (QUIET.travel_m, T_A * (1.0 + growth))):
        plant = rig_with(x_m=x_m, position_dependent_inductance=growth)

        plant.advance(2.0, STEP_S)  # so short that the ball stays where it is

        time_constant_s = -STEP_S / math.log(1.0 - plant.i_c_a / (K_A * 2.0))
        assert time_constant_s == pytest.approx(expected_s, rel=1e-3)


def a_rising_ball_pushes_the_current_down(coupling: float) -> None:
    for speed in (0.1, -0.1):
        plant = rig_with(x_m=MIDDLE_M, v_m_s=speed, i_c_a=0.6, motional_emf=coupling)

        plant.advance(0.6 / K_A, STEP_S)

        expected = -coupling * 0.6 * speed * STEP_S / T_A
        assert plant.i_c_a - 0.6 == pytest.approx(expected, rel=STEP_S / T_A)  # the lag gives back half of that


def the_input_acts_later(delay: float) -> None:
    delayed, plain = rig_with(actuation_delay=delay), rig_with()

    delayed.advance(2.0, delay)
    assert delayed.i_c_a == 0.0

    delayed.advance(2.0, 0.001)
    plain.advance(2.0, 0.001)
    assert delayed.i_c_a == plain.i_c_a


def the_coil_is_further_away(offset: float) -> None:
    farther = balance_current_a(MIDDLE_M, air_gap_offset=offset)
    nearer = balance_current_a(MIDDLE_M, air_gap_offset=-offset)

    gap = QUIET.gap_m(MIDDLE_M)
    assert farther / MIDDLE_A == pytest.approx((gap + offset) / gap, rel=1e-3)
    assert nearer / MIDDLE_A == pytest.approx((gap - offset) / gap, rel=1e-3)


def the_force_falls_faster_with_the_gap(exponent: float) -> None:
    assert balance_current_a(MIDDLE_M, force_exponent=exponent) == pytest.approx(MIDDLE_A, rel=1e-3)
    for x_m in (1e-3, 5e-3):
        ratio = balance_current_a(x_m, force_exponent=exponent) / QUIET.equilibrium_current_a(x_m)
        expected = (QUIET.gap_m(x_m) / QUIET.gap_m(MIDDLE_M)) ** (exponent / 2.0 - 1.0)
        assert ratio == pytest.approx(expected, rel=1e-3)


def a_saturated_core_needs_more_current(saturation: float) -> None:
    needed = balance_current_a(MIDDLE_M, core_saturation=saturation)

    assert needed == pytest.approx(MIDDLE_A / math.sqrt(1.0 - (MIDDLE_A / saturation) ** 2), rel=1e-3)


def a_magnetised_core_needs_less_current(residual: float) -> None:
    assert balance_current_a(MIDDLE_M, residual_magnetism=residual) == pytest.approx(MIDDLE_A - residual, rel=1e-3)


def the_force_outlives_the_current(tau: float) -> None:
    speeds = []
    for effect in ({}, {"eddy_current_lag": tau}):
        plant = rig_with(x_m=MIDDLE_M, i_c_a=MIDDLE_A, **effect)
        plant.advance(0.0, 10.0 * tau)
        speeds.append(plant.v_m_s)

    # Force over weight is the square of the decaying field: its integral with both lags, less that with T_A alone.
    both = (tau**2 + 3.0 * tau * T_A + T_A**2) / (2.0 * (tau + T_A))
    assert speeds[1] - speeds[0] == pytest.approx(QUIET.gravity_m_s2 * (both - T_A / 2.0), rel=0.05)


def fast_motion_is_braked_by_its_square(c: float) -> None:
    for speed in (0.3, -0.3):
        braked, plain = (rig_with(x_m=MIDDLE_M, v_m_s=speed, **effect) for effect in ({"quadratic_drag": c}, {}))

        braked.advance(0.0, STEP_S)
        plain.advance(0.0, STEP_S)

        expected = -c * abs(speed) * speed / QUIET.mass_kg * STEP_S
        assert braked.v_m_s - plain.v_m_s == pytest.approx(expected, rel=1e-2)


def dry_friction_brakes_and_holds(force: float) -> None:
    for speed in (0.2, -0.2):
        braked, plain = (rig_with(x_m=MIDDLE_M, v_m_s=speed, **effect) for effect in ({"coulomb_friction": force}, {}))
        braked.advance(0.0, 0.001)
        plain.advance(0.0, 0.001)
        expected = -math.copysign(force / QUIET.mass_kg * 0.001, speed)
        assert braked.v_m_s - plain.v_m_s == pytest.approx(expected, rel=1e-2)  # linear drag differs a little

    for share, moves in ((0.9, False), (1.1, True)):  # of the force that friction can hold
        current = MIDDLE_A * math.sqrt(1.0 + share * force / WEIGHT_N)
        held = rig_with(x_m=MIDDLE_M, i_c_a=current, coulomb_friction=force)
        held.advance(current / K_A, 0.02)
        assert (held.x_m > MIDDLE_M) is moves
        assert held.x_m >= MIDDLE_M


def an_upward_force_carries_part_of_the_ball(force: float) -> None:
    lighter = balance_current_a(MIDDLE_M, constant_force=force)
    heavier = balance_current_a(MIDDLE_M, constant_force=-force)

    assert lighter == pytest.approx(MIDDLE_A * math.sqrt(1.0 - force / WEIGHT_N), rel=1e-3)
    assert heavier == pytest.approx(MIDDLE_A * math.sqrt(1.0 + force / WEIGHT_N), rel=1e-3)


def the_ball_is_shaken_at_seven_hertz(amplitude: float) -> None:
    weightless = replace(QUIET, gravity_m_s2=0.0, drag_n_s_m=0.0)
    plant = rig_with(weightless, x_m=1e-4, periodic_disturbance=amplitude)
    omega = 2.0 * math.pi * 7.0

    for n in range(1, 21):
        plant.advance(0.0, 0.002)
        expected = amplitude / (QUIET.mass_kg * omega) * (1.0 - math.cos(omega * n * 0.002))
        assert plant.v_m_s == pytest.approx(expected, rel=1e-6)


def x_reads_too_high(offset: float) -> None:
    for x_m in (0.0, MIDDLE_M, QUIET.travel_m):
        assert rig_with(x_m=x_m, position_sensor_offset=offset).sense()[1] == pytest.approx(x_m + offset, rel=1e-12)


def x_reads_in_proportion(gain: float) -> None:
    for x_m in (0.0, MIDDLE_M, QUIET.travel_m):
        assert rig_with(x_m=x_m, position_sensor_gain=gain).sense()[1] == pytest.approx(gain * x_m, rel=1e-12)


def x_reads_bent_between_the_stops(bow: float) -> None:
    for share, expected in ((0.0, 0.0), (0.25, 0.75), (0.5, 1.0), (1.0, 0.0)):
        x_m = share * QUIET.travel_m
        measured = rig_with(x_m=x_m, position_sensor_nonlinearity=bow).sense()[1]
        assert measured - x_m == pytest.approx(expected * bow, abs=1e-15)


def x_lags_behind_a_moving_ball(tau: float) -> None:
    weightless = replace(QUIET, gravity_m_s2=0.0, drag_n_s_m=0.0)
    plant = rig_with(weightless, x_m=1e-3, v_m_s=0.1, position_sensor_lag=tau)

    plant.advance(0.0, 0.02)

    behind = plant.x_m - plant.sense()[1]
    assert behind == pytest.approx(0.1 * tau * (1.0 - math.exp(-0.02 / tau)), rel=1e-6)


def the_current_shows_in_x(coupling: float) -> None:
    plant = rig_with(sensor_crosstalk=coupling)

    plant.advance(2.0, 0.01)

    assert plant.x_m == 0.0
    assert plant.sense()[1] == pytest.approx(coupling * plant.i_c_a, rel=1e-12)


def i_reads_too_high(offset: float) -> None:
    for current in (0.0, 0.7):
        measured = rig_with(i_c_a=current, current_sensor_offset=offset).sense()[0]
        assert measured == pytest.approx(current + offset, rel=1e-12)


def i_reads_in_proportion(gain: float) -> None:
    for current in (0.0, 0.7):
        assert rig_with(i_c_a=current, current_sensor_gain=gain).sense()[0] == pytest.approx(gain * current, rel=1e-12)


def both_sensors_show_the_past(delay: float) -> None:
    delayed, plain = rig_with(x_m=MIDDLE_M, sampling_delay=delay), rig_with(x_m=MIDDLE_M)
    plain.advance(4.0, 0.01)
    then = plain.sense()

    delayed.advance(4.0, 0.01)
    delayed.advance(1.0, delay)

    assert delayed.sense() == then
    assert delayed.x_m != then[1]


def frames_are_lost_at_the_given_rate(probability: float) -> None:
    count = 20_000
    plant = rig_with(lost_samples=probability)

    share = sum(plant.drop_sample() for _ in range(count)) / count

    assert abs(share - probability) < 4.5 * math.sqrt(probability * (1.0 - probability) / count)


CONSEQUENCES: Mapping[str, Callable[[float], None]] = {
    "amplifier-gain-drift": a_warm_coil_gives_less_current,
    "current-limit": the_current_ends_at_the_limit,
    "slew-rate-limit": the_current_rises_in_a_straight_line,
    "amplifier-dead-zone": the_dead_zone_is_missing_from_the_input,
    "amplifier-offset": current_flows_without_input,
    "position-dependent-inductance": the_current_is_slower_near_the_coil,
    "motional-emf": a_rising_ball_pushes_the_current_down,
    "actuation-delay": the_input_acts_later,
    "air-gap-offset": the_coil_is_further_away,
    "force-exponent": the_force_falls_faster_with_the_gap,
    "core-saturation": a_saturated_core_needs_more_current,
    "residual-magnetism": a_magnetised_core_needs_less_current,
    "eddy-current-lag": the_force_outlives_the_current,
    "quadratic-drag": fast_motion_is_braked_by_its_square,
    "coulomb-friction": dry_friction_brakes_and_holds,
    "constant-force": an_upward_force_carries_part_of_the_ball,
    "periodic-disturbance": the_ball_is_shaken_at_seven_hertz,
    "position-sensor-offset": x_reads_too_high,
    "position-sensor-gain": x_reads_in_proportion,
    "position-sensor-nonlinearity": x_reads_bent_between_the_stops,
    "position-sensor-lag": x_lags_behind_a_moving_ball,
    "sensor-crosstalk": the_current_shows_in_x,
    "current-sensor-offset": i_reads_too_high,
    "current-sensor-gain": i_reads_in_proportion,
    "sampling-delay": both_sensors_show_the_past,
    "lost-samples": frames_are_lost_at_the_given_rate,
}


def test_every_cause_of_the_catalogue_can_be_switched_on() -> None:
    assert set(CATALOGUE) <= set(EFFECTS)
    assert set(CONSEQUENCES) == set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_effect_has_the_consequence_of_its_formula(name: str) -> None:
    CONSEQUENCES[name](EFFECTS[name].medium)


def test_effects_of_two_places_add_up() -> None:
    plant = rig_with(current_sensor_offset=0.02, amplifier_offset=0.03)

    plant.advance(0.0, 0.01)

    assert plant.sense()[0] == pytest.approx(0.05, rel=1e-9)


def test_an_effect_switched_on_later_acts_from_then_on() -> None:
    plant = rig_with()
    plant.advance(2.0, 0.01)

    plant.set_effects({"amplifier-offset": 0.03})

    assert plant.i_c_a == pytest.approx(K_A * 2.0, rel=1e-9)
    plant.advance(2.0, 0.01)
    assert plant.i_c_a == pytest.approx(K_A * 2.0 + 0.03, rel=1e-9)
    assert plant.time_s == pytest.approx(0.02)


def test_delays_fit_the_memory_of_the_plant() -> None:
    delayed = rig_with(actuation_delay=MAX_DELAY_S, sampling_delay=MAX_DELAY_S)

    delayed.advance(2.0, MAX_DELAY_S + 0.01)
    assert (delayed.i_c_a > 0.0, delayed.sense()[0]) == (True, 0.0)

    delayed.advance(2.0, MAX_DELAY_S)
    assert delayed.sense()[0] == pytest.approx(K_A * 2.0, rel=1e-6)


def test_the_step_resolves_a_tick_and_a_capture_sample() -> None:
    for period_s in (0.002, 40e-6):
        assert period_s / STEP_S == pytest.approx(round(period_s / STEP_S), abs=1e-9)
