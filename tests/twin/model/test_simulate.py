"""The kernels against formulas and against themselves at finer steps."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.harness.twin.one_tick import numbers, tick
from tests.harness.twin.plain_python import compiled_and_plain
from twin.model.parameters import Model
from twin.model.simulate import PlantNumbers, plant_numbers

T_S = 2e-3


def with_values(**values: float) -> Model:
    model = Model.load("ce152")
    parameters = {key: dataclasses.replace(p, value=values.get(key, p.value)) for key, p in model.parameters.items()}
    return dataclasses.replace(model, parameters=parameters)


def test_the_amplifier_is_exact_at_every_tick() -> None:
    p = plant_numbers(Model.load("ce152"), T_S)
    i, u = 0.0, 2.0

    for k in range(1, 6):
        i, _, _ = tick(p, i, 0.0, 0.0, u)

        assert i == pytest.approx(0.297 * u * (1.0 - math.exp(-k * T_S / 3e-4)), rel=1e-13)


def test_a_ball_without_current_falls_as_the_formula_says() -> None:
    """M v' = -m g - b v: x = x0 - g tau t + g tau^2 (1 - exp(-t / tau)), tau = m / b.

    The longest substep is h = 1 ms: (h / tau)^5 / 120 g tau^2 = 2e-11 m, 14 times.
    """
    p = plant_numbers(with_values(b=0.5), T_S)
    x0, tau, g = 5.6e-3, 8.28e-3 / 0.5, 9.81
    i, x, v = 0.0, x0, 0.0

    for k in range(1, 15):
        i, x, v = tick(p, i, x, v, 0.0)
        t = k * T_S

        assert x == pytest.approx(x0 - g * tau * t + g * tau**2 * (1.0 - math.exp(-t / tau)), abs=3e-10)


def test_without_drag_and_with_constant_current_energy_is_conserved() -> None:
    """Force (3) has the potential -K_c i^2 / (x_max - x)."""
    p = plant_numbers(with_values(b=0.0), T_S)
    base = numbers(p)
    i = 0.6
    x, v = 2.8e-3, 0.0

    def energy(x: float, v: float) -> float:
        m, g = 8.28e-3, 9.81
        return 0.5 * m * v * v + m * g * x - base.K_c * i * i / (base.x_max_m - x)

    start = energy(x, v)
    while x < 3.4e-3:  # from rest towards the coil
        _, x, v = tick(p, i, x, v, i / base.K_A)

        kinetic = 0.5 * 8.28e-3 * v * v
        assert abs(energy(x, v) - start) < 1e-5 * kinetic + 1e-15


def test_a_ball_at_rest_stays_until_the_force_of_eq_8_is_reached() -> None:
    p = plant_numbers(Model.load("ce152"), T_S)
    lift_off = math.sqrt(8.28e-3 * 9.81 / 2.7507e-6) * 5.7e-3

    for share, moves in ((0.999, False), (1.001, True)):
        i, x, v = share * lift_off, 0.0, 0.0
        for _ in range(10):
            i, x, v = tick(p, i, x, v, share * lift_off / numbers(p).K_A)

        assert (x > 0.0) is moves


@pytest.mark.parametrize("u", [0.0, 5.0])
def test_the_stops_hold_the_ball(u: float) -> None:
    p = plant_numbers(Model.load("ce152"), T_S)
    i, x, v = 0.5, 2.85e-3, 0.0

    for _ in range(200):
        i, x, v = tick(p, i, x, v, u)

        assert 0.0 <= x <= 5.7e-3
        assert math.isfinite(v)
    assert x == (5.7e-3 if u else 0.0)
    assert v == 0.0


def test_the_ball_leaves_the_top_stop_when_the_coil_is_switched_off() -> None:
    p = plant_numbers(Model.load("ce152"), T_S)
    i, x, v = 1.4, 5.7e-3, 0.0

    for _ in range(40):
        i, x, v = tick(p, i, x, v, 0.0)

    assert x == 0.0


def reference_tick(p: PlantNumbers, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """(1) and (6) by an adaptive solver with tight tolerances, no stops."""
    q = numbers(p)

    def right(_: float, z: Any) -> list[float]:
        gap = q.x_max_m - z[1]
        force = q.K_c * z[0] ** 2 / gap**2 - q.b * z[2]
        return [(q.K_A * u - z[0]) / q.T_A, z[2], force / q.mass_kg - q.gravity_m_s2]

    z = solve_ivp(right, (0.0, p.sample_time_s), [i, x, v], method="LSODA", rtol=1e-12, atol=1e-14).y[:, -1]
    return float(z[0]), float(z[1]), float(z[2])


@pytest.mark.parametrize(("gap_above_stop_m", "tolerance_m"), [(0.0, 2e-7), (2.438e-3, 6e-8)])
def test_a_tick_agrees_with_an_adaptive_solver(gap_above_stop_m: float, tolerance_m: float) -> None:
    """Over currents, positions, speeds and inputs of a flying ball, jumps of 1 A right under the coil included.

    Largest error: a seventh of a converter count (1.4 um) with the coil's pole at the top stop, a twentieth with it
    where the real one is.
    """
    rng = np.random.default_rng(7)
    model = with_values()
    plant = dataclasses.replace(model.plant, x_max_m=model.plant.x_max_m + gap_above_stop_m)
    p = plant_numbers(dataclasses.replace(model, plant=plant), T_S)

    for _ in range(60):
        i, u = rng.uniform(0.2, 1.2), rng.uniform(0.5, 4.5)
        x, v = rng.uniform(0.5e-3, 4.5e-3), rng.uniform(-0.05, 0.05)

        after = tick(p, i, x, v, u)

        i_ref, x_ref, v_ref = reference_tick(p, i, x, v, u)
        assert after[0] == pytest.approx(i_ref, rel=1e-9)
        assert after[1] == pytest.approx(x_ref, abs=tolerance_m)
        assert after[2] == pytest.approx(v_ref, abs=2.0 * tolerance_m / T_S)


@pytest.mark.parametrize("sample_time_s", [1e-4, 5e-4, 2e-2])
def test_other_sampling_times_agree_with_an_adaptive_solver(sample_time_s: float) -> None:
    """From rest and under the input that holds the ball: over 20 ms it would fall away from any other."""
    p = plant_numbers(Model.load("ce152"), sample_time_s)
    u = 1.01 * 0.48975 / 0.297

    after = tick(p, 0.48975, 2.85e-3, 0.0, u)

    assert after == pytest.approx(reference_tick(p, 0.48975, 2.85e-3, 0.0, u), rel=1e-4, abs=1e-8)


_TRAJECTORY = """
import json
from twin.model.parameters import Model
from twin.mirror.loop import advance
from twin.control import LawNumbers
from twin.model.simulate import plant_numbers, rig_at
p = plant_numbers(Model.load("ce152"), 2e-3)
c = tuple(LawNumbers(1.65, 0.49, 2.85e-3, 0.49, 1700.0, 0.0, 17.7, 17600.0, 0.0, 5.0, 1.0, 2e-3))
memory = rig_at(p, i=0.0, x=0.0, v=0.0, u=0.0)
out = []
for k in range(150):
    i, x, v, u = advance(tuple(p), c, memory, True, 2.85e-3, 0.0)
    out.append([u, i, x, v])
print(json.dumps(out))
"""


@pytest.mark.slow
def test_compiled_and_plain_python_give_the_same_flight() -> None:
    """The same file without numba is the oracle; exp and the order of operations may differ in the last digits."""
    flights = compiled_and_plain(_TRAJECTORY)

    assert np.allclose(flights[0], flights[1], rtol=1e-9, atol=1e-13)
    assert abs(flights[0][-1][2] - 2.85e-3) < 1e-4
