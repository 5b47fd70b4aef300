"""The emulated rig without effects: statics against measurements, dynamics against closed formulas."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gateway.emulator.plant.constants import CE152, MEASURED_EQUILIBRIA, PlantConstants
from gateway.emulator.plant.levitation import STEP_S, EmulatedPlant
from protocol.errors import ConfigError, UsageError
from tests.patience import HANG_S

REPOSITORY = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("BOARD51_DATA", REPOSITORY.parent / "shared" / "data"))
QUIET = replace(CE152, position_noise_m=0.0, current_noise_a=0.0)
FRICTIONLESS = replace(QUIET, drag_n_s_m=0.0)
TICK_S = 0.002
LIFT_OFF_V = CE152.equilibrium_input_v(0.0)


def balance_current_a(x_m: float) -> float:
    """The current at which a ball let go at x moves neither way, found by trying."""
    low, high = 0.0, CE152.current_max_a
    for _ in range(40):
        middle = 0.5 * (low + high)
        plant = EmulatedPlant(QUIET)
        plant.set_state(x_m, i_c_a=middle)
        plant.advance(middle / CE152.amplifier_gain_a_v, 0.001)
        low, high = (low, middle) if plant.v_m_s > 0 else (middle, high)
    return 0.5 * (low + high)


@pytest.mark.parametrize(("gap_m", "current_a"), MEASURED_EQUILIBRIA)
def test_a_measured_equilibrium_needs_the_measured_current(gap_m: float, current_a: float) -> None:
    assert balance_current_a(CE152.travel_m - gap_m) == pytest.approx(current_a, rel=0.02)


def test_the_published_table_is_met_within_two_percent() -> None:
    table = DATA / "ce152-equilibria" / "equilibria.csv"
    if not table.exists():
        pytest.skip(f"{table} is not here; BOARD51_DATA tells where")
    with table.open(newline="") as file:
        rows = [(float(row["gap_m"]), float(row["current_A"])) for row in csv.DictReader(file)]

    errors = [CE152.equilibrium_current_a(CE152.travel_m - gap) / current - 1.0 for gap, current in rows]

    assert len(rows) == 4
    assert max(map(abs, errors)) < 0.02


def test_the_rigs_force_constants_are_the_least_squares_fit_of_the_measured_points() -> None:
    gaps, currents = np.array(MEASURED_EQUILIBRIA).T

    slope, intercept = np.polyfit(gaps, currents, 1)

    assert CE152.coil_plane_above_stop_m == pytest.approx(intercept / slope, rel=5e-4)
    assert CE152.force_constant_n_m2_a2 == pytest.approx(CE152.mass_kg * 9.81 / slope**2, rel=5e-4)


def test_eq_3_with_its_pole_at_the_top_stop_misses_the_table_whatever_its_constant() -> None:
    slopes = [current / gap for gap, current in MEASURED_EQUILIBRIA]  # sqrt(m g / K_c) if eq. (3) were all

    assert max(slopes) / min(slopes) > 1.02 / 0.98


def test_the_ball_lifts_off_just_above_the_input_of_its_equilibrium_at_the_bottom() -> None:
    below, above = EmulatedPlant(QUIET), EmulatedPlant(QUIET)

    below.advance(LIFT_OFF_V * 0.999, 0.5)
    above.advance(LIFT_OFF_V * 1.001, 0.5)

    assert (below.x_m, below.v_m_s) == (0.0, 0.0)
    assert above.x_m > 1e-3


def test_free_fall_is_half_g_t_squared() -> None:
    plant = EmulatedPlant(FRICTIONLESS)
    plant.set_state(5e-3)

    for _ in range(15):
        plant.advance(0.0, TICK_S)

    t = 15 * TICK_S
    assert plant.x_m == pytest.approx(5e-3 - 0.5 * 9.81 * t**2, abs=1e-15)  # Runge-Kutta is exact for parabolas
    assert plant.v_m_s == pytest.approx(-9.81 * t, abs=1e-13)


def test_a_fall_with_drag_follows_its_exponential() -> None:
    plant = EmulatedPlant(QUIET)
    plant.set_state(5e-3)

    plant.advance(0.0, 0.03)

    rate = QUIET.drag_n_s_m / QUIET.mass_kg
    assert plant.v_m_s == pytest.approx(-9.81 / rate * (1.0 - math.exp(-rate * 0.03)), rel=1e-12)


def test_without_drag_a_steady_current_conserves_energy() -> None:
    current = FRICTIONLESS.equilibrium_current_a(3e-3)
    plant = EmulatedPlant(FRICTIONLESS)
    plant.set_state(2e-3, v_m_s=0.08, i_c_a=current)

    def energy_j() -> float:
        kinetic = 0.5 * FRICTIONLESS.mass_kg * plant.v_m_s**2
        lifted = FRICTIONLESS.mass_kg * 9.81 * plant.x_m
        return kinetic + lifted - FRICTIONLESS.force_constant_n_m2_a2 * current**2 / FRICTIONLESS.gap_m(plant.x_m)

    before, visited = energy_j(), []
    for _ in range(20):
        plant.advance(current / FRICTIONLESS.amplifier_gain_a_v, 0.001)
        visited.append(plant.x_m)
        assert energy_j() == pytest.approx(before, abs=1e-12 * abs(before) + 1e-15)

    assert max(visited) - min(visited) > 5e-4  # it did move
    assert 0.0 < min(visited) < max(visited) < FRICTIONLESS.travel_m


@pytest.mark.parametrize("duration_s", [0.02, 0.06], ids=["in flight", "through a bounce"])
def test_halving_the_step_divides_the_error_by_sixteen(duration_s: float) -> None:
    def end_m(step_s: float) -> float:
        plant = EmulatedPlant(QUIET, step_s=step_s)
        plant.set_state(4e-3, v_m_s=0.02, i_c_a=1.0)
        plant.advance(1.2, duration_s)
        return plant.x_m

    truth = end_m(5e-6)
    errors = [abs(end_m(step) - truth) for step in (80e-6, 40e-6, 20e-6)]

    assert errors[2] < 1e-9
    for coarse, halved in pairwise(errors):
        assert 12.0 < coarse / halved < 24.0  # 4th order: 16, with the next term of the series on top


def test_a_bounce_keeps_the_restitution_share_of_the_speed() -> None:
    plant = EmulatedPlant(FRICTIONLESS)
    plant.set_state(4e-3)
    plant.advance(0.0, 0.028)
    assert plant.v_m_s < 0

    plant.advance(0.0, 0.002)  # touches after sqrt(2 h / g) = 28.56 ms

    landing_s, speed = math.sqrt(2 * 4e-3 / 9.81), math.sqrt(2 * 9.81 * 4e-3)
    left = 0.03 - landing_s
    assert plant.v_m_s == pytest.approx(FRICTIONLESS.restitution * speed - 9.81 * left, rel=1e-9)
    assert plant.x_m == pytest.approx(FRICTIONLESS.restitution * speed * left - 0.5 * 9.81 * left**2, rel=1e-9)


def test_rebounds_get_lower_and_end_at_rest_without_chatter() -> None:
    plant = EmulatedPlant(FRICTIONLESS)
    plant.set_state(4e-3)
    heights = []
    previous = plant.v_m_s
    for _ in range(10_000):
        plant.advance(0.0, STEP_S)
        if previous > 0.0 >= plant.v_m_s:
            heights.append(plant.x_m)
        previous = plant.v_m_s

    restitution = FRICTIONLESS.restitution
    expected = [4e-3 * restitution ** (2 * n) for n in range(1, 5)]
    assert heights[:4] == pytest.approx(expected, rel=0.01)  # seen to one step: 0.5 g (20 us)^2 = 2e-9 m
    assert len(heights) < 12
    for _ in range(500):
        plant.advance(0.0, TICK_S)
        assert (plant.x_m, plant.v_m_s) == (0.0, 0.0)


def test_the_ball_is_held_at_the_top_stop_exactly() -> None:
    plant = EmulatedPlant(QUIET)
    plant.advance(5.0, 0.5)

    for _ in range(100):
        plant.advance(5.0, TICK_S)
        assert (plant.x_m, plant.v_m_s) == (QUIET.travel_m, 0.0)

    plant.advance(0.0, 0.02)
    assert plant.x_m < QUIET.travel_m


def test_a_ball_on_the_bottom_without_current_never_moves() -> None:
    plant = EmulatedPlant()

    for _ in range(500):
        plant.advance(0.0, TICK_S)
        assert (plant.x_m, plant.v_m_s, plant.i_c_a) == (0.0, 0.0, 0.0)


def test_the_current_rises_exponentially_with_the_amplifiers_time_constant() -> None:
    plant = EmulatedPlant(QUIET)

    for n in range(1, 51):
        plant.advance(2.0, 40e-6)
        expected = QUIET.amplifier_gain_a_v * 2.0 * (1.0 - math.exp(-n * 40e-6 / QUIET.amplifier_time_constant_s))
        assert plant.i_c_a == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("u_v", "same_as_v"), [(9.0, 5.0), (-3.0, 0.0), (math.inf, 5.0)])
def test_the_amplifier_limits_its_input(u_v: float, same_as_v: float) -> None:
    overdriven, limit = EmulatedPlant(QUIET), EmulatedPlant(QUIET)

    overdriven.advance(u_v, 0.01)
    limit.advance(same_as_v, 0.01)

    assert overdriven.i_c_a == limit.i_c_a


def test_the_current_stays_within_its_range() -> None:
    plant = EmulatedPlant(replace(QUIET, amplifier_gain_a_v=0.4))

    plant.advance(5.0, 0.01)
    assert plant.i_c_a == pytest.approx(1.5, rel=1e-9)

    plant.advance(0.0, 0.01)
    assert 0.0 <= plant.i_c_a < 1e-9


def test_cutting_a_tick_into_capture_samples_changes_nothing() -> None:
    whole, pieces = EmulatedPlant(seed=5), EmulatedPlant(seed=5)
    inputs = np.random.default_rng(8).uniform(0.0, 5.0, 200).tolist()

    for u in inputs:
        whole.advance(u, TICK_S)
        for _ in range(50):
            pieces.advance(u, 40e-6)

        assert (whole.i_c_a, whole.x_m, whole.v_m_s) == (pieces.i_c_a, pieces.x_m, pieces.v_m_s)
        assert whole.sense() == pieces.sense()
    assert whole.time_s == pieces.time_s == pytest.approx(0.4)


def test_the_seed_decides_the_noise_and_nothing_else() -> None:
    plants = {name: EmulatedPlant(seed=seed) for name, seed in (("a", 1), ("again", 1), ("other", 2))}
    readings: dict[str, list[tuple[float, float]]] = {name: [] for name in plants}
    for name, plant in plants.items():
        for _ in range(50):
            plant.advance(4.0, TICK_S)
            readings[name].append(plant.sense())

    assert readings["a"] == readings["again"]
    assert readings["a"] != readings["other"]
    assert plants["a"].x_m == plants["other"].x_m


def test_sensor_noise_has_the_rigs_standard_deviation_and_no_bias() -> None:
    count = 20_000
    plant = EmulatedPlant(seed=3)
    plant.set_state(3e-3, i_c_a=0.5)

    i, x = np.array([plant.sense() for _ in range(count)]).T

    for noise, sigma in ((i - 0.5, CE152.current_noise_a), (x - 3e-3, CE152.position_noise_m)):
        assert abs(noise.mean()) < 4.5 * sigma / math.sqrt(count)
        assert abs(noise.std() / sigma - 1.0) < 4.5 / math.sqrt(2 * count)


def test_asking_for_lost_frames_leaves_the_noise_alone() -> None:
    queried, silent = EmulatedPlant(seed=4), EmulatedPlant(seed=4)

    drops = [queried.drop_sample() for _ in range(100)]

    assert queried.sense() == silent.sense()
    assert not any(drops)


@pytest.mark.parametrize(("u_v", "duration_s"), [(1.0, -0.002), (1.0, 3e-6), (math.nan, 0.002), (1.0, math.inf)])
def test_an_impossible_advance_is_refused_with_its_values(u_v: float, duration_s: float) -> None:
    with pytest.raises(UsageError, match=f"{duration_s} s with u = {u_v} V"):
        EmulatedPlant().advance(u_v, duration_s)


def test_the_ball_is_placed_within_its_travel_only() -> None:
    with pytest.raises(UsageError, match=r"x = 0\.01 m"):
        EmulatedPlant().set_state(0.01)


@pytest.mark.parametrize(("key", "value"), [("mass_kg", 0.0), ("restitution", 1.0), ("travel_m", math.nan)])
def test_an_impossible_rig_is_refused(key: str, value: float) -> None:
    numbers: dict[str, float] = {key: value}
    with pytest.raises(ConfigError, match=key):
        replace(CE152, **numbers)


def test_without_a_compiler_the_same_numbers_come_out() -> None:
    program = (
        "import sys; sys.modules['numba'] = None\n"
        "from gateway.emulator.plant.levitation import EmulatedPlant\n"
        "plant = EmulatedPlant(effects={'coulomb-friction': 0.002, 'eddy-current-lag': 0.001}, seed=1)\n"
        "plant.advance(5.0, 0.03); plant.advance(0.0, 0.03)\n"
        "print(repr((plant.i_c_a, plant.x_m, plant.v_m_s)))\n"
    )
    process = subprocess.run(
        [sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, timeout=HANG_S, check=True
    )
    plant = EmulatedPlant(effects={"coulomb-friction": 0.002, "eddy-current-lag": 0.001}, seed=1)
    plant.advance(5.0, 0.03)
    plant.advance(0.0, 0.03)

    plain = [float(number) for number in process.stdout.strip(" ()\n").split(",")]
    assert plain == pytest.approx([plant.i_c_a, plant.x_m, plant.v_m_s], rel=1e-9)
    assert plant.x_m > 0.0


def test_a_rig_loads_nothing_of_scipy_s_linear_algebra_and_leaves_it_to_others() -> None:
    program = (
        "import sys\n"
        "from gateway.emulator.plant.levitation import EmulatedPlant\n"
        "EmulatedPlant().advance(5.0, 0.03)\n"
        "assert 'numba' in sys.modules and 'scipy.linalg' not in sys.modules\n"
        "import numba, numpy\n"
        "assert numba.njit(lambda a: a @ a)(numpy.eye(2))[0, 0] == 1.0\n"
    )
    subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, timeout=HANG_S, check=True)


def test_a_rig_of_other_numbers_is_a_plant_too() -> None:
    heavy: PlantConstants = replace(QUIET, mass_kg=0.02, current_max_a=3.0, input_max_v=10.0)
    plant = EmulatedPlant(heavy)

    plant.advance(heavy.equilibrium_input_v(0.0) * 0.99, 0.1)
    assert plant.x_m == 0.0
    plant.advance(heavy.equilibrium_input_v(0.0) * 1.01, 0.1)
    assert plant.x_m > 0.0
