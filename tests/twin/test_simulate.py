"""The kernels against formulas and against themselves at finer steps."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.model.nominal import nominal
from twin.model.parameters import Model
from twin.simulate import PlantNumbers, plant_numbers, tick, ticks

T_S = 2e-3


def with_values(**values: float) -> Model:
    model = nominal()
    parameters = {key: dataclasses.replace(p, value=values.get(key, p.value)) for key, p in model.parameters.items()}
    return dataclasses.replace(model, parameters=parameters)


def test_the_amplifier_is_exact_at_every_tick() -> None:
    p = plant_numbers(nominal(), T_S)
    i, u = 0.0, 2.0

    for k in range(1, 6):
        i, _, _ = tick(p, i, 0.0, 0.0, u)

        assert i == pytest.approx(0.297 * u * (1.0 - math.exp(-k * T_S / 3e-4)), rel=1e-13)


def test_a_ball_without_current_falls_as_the_formula_says() -> None:
    """M v' = -m g - b v: x = x0 - g tau t + g tau^2 (1 - exp(-t / tau)), tau = m / b."""
    p = plant_numbers(with_values(b=0.5), T_S)
    x0, tau, g = 5.6e-3, 8.28e-3 / 0.5, 9.81
    i, x, v = 0.0, x0, 0.0

    for k in range(1, 15):
        i, x, v = tick(p, i, x, v, 0.0)
        t = k * T_S

        assert x == pytest.approx(x0 - g * tau * t + g * tau**2 * (1.0 - math.exp(-t / tau)), abs=1e-12)


def test_without_drag_and_with_constant_current_energy_is_conserved() -> None:
    """Force (3) has the potential -K_c i^2 / (x_max - x)."""
    p = plant_numbers(with_values(b=0.0), T_S)
    i = 0.6
    x, v = 2.8e-3, 0.0

    def energy(x: float, v: float) -> float:
        m, g = 8.28e-3, 9.81
        return 0.5 * m * v * v + m * g * x - p.k * m * i * i / (p.x_max_m - x)

    start = energy(x, v)
    while x < 4e-3:  # from rest towards the coil
        _, x, v = tick(p, i, x, v, i / p.K_A)

        kinetic = 0.5 * 8.28e-3 * v * v
        assert abs(energy(x, v) - start) < 1e-6 * kinetic + 1e-15


def test_a_ball_at_rest_stays_until_the_force_of_eq_8_is_reached() -> None:
    p = plant_numbers(nominal(), T_S)
    lift_off = math.sqrt(8.28e-3 * 9.81 / 2.7507e-6) * 5.7e-3

    for share, moves in ((0.999, False), (1.001, True)):
        i, x, v = share * lift_off, 0.0, 0.0
        for _ in range(10):
            i, x, v = tick(p, i, x, v, share * lift_off / p.K_A)

        assert (x > 0.0) is moves


@pytest.mark.parametrize("u", [0.0, 5.0])
def test_the_stops_hold_the_ball(u: float) -> None:
    p = plant_numbers(nominal(), T_S)
    i, x, v = 0.5, 2.85e-3, 0.0

    for _ in range(200):
        i, x, v = tick(p, i, x, v, u)

        assert 0.0 <= x <= 5.7e-3
        assert math.isfinite(v)
    assert x == (5.7e-3 if u else 0.0)
    assert v == 0.0


def test_the_ball_leaves_the_top_stop_when_the_coil_is_switched_off() -> None:
    p = plant_numbers(nominal(), T_S)
    i, x, v = 1.4, 5.7e-3, 0.0

    for _ in range(40):
        i, x, v = tick(p, i, x, v, 0.0)

    assert x == 0.0


def reference_tick(p: PlantNumbers, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """(1) and (6) by an adaptive solver with tight tolerances, no stops."""
    T_A = -0.5 * p.sample_time_s / p.substeps / math.log(p.half_step_decay)

    def right(_: float, z: Any) -> list[float]:
        gap = p.x_max_m - z[1]
        return [(p.K_A * u - z[0]) / T_A, z[2], p.k * z[0] ** 2 / gap**2 - p.d * z[2] - p.gravity_m_s2]

    z = solve_ivp(right, (0.0, p.sample_time_s), [i, x, v], method="LSODA", rtol=1e-12, atol=1e-14).y[:, -1]
    return float(z[0]), float(z[1]), float(z[2])


def test_a_tick_agrees_with_an_adaptive_solver_and_halving_the_step_changes_nothing() -> None:
    """Over currents, positions, speeds and inputs of a flying ball: 20 nm is a hundredth of a converter count."""
    rng = np.random.default_rng(7)
    p = plant_numbers(nominal(), T_S)
    fine = plant_numbers(nominal(), T_S, substeps=2 * p.substeps)

    for _ in range(60):
        i, u = rng.uniform(0.2, 1.2), rng.uniform(0.5, 4.5)
        x, v = rng.uniform(0.5e-3, 4.5e-3), rng.uniform(-0.05, 0.05)

        coarse = tick(p, i, x, v, u)

        assert abs(coarse[1] - tick(fine, i, x, v, u)[1]) < 2e-8
        i_ref, x_ref, v_ref = reference_tick(p, i, x, v, u)
        assert coarse[0] == pytest.approx(i_ref, rel=1e-9)
        assert coarse[1] == pytest.approx(x_ref, abs=2e-8)
        assert coarse[2] == pytest.approx(v_ref, abs=2e-8 / (T_S / p.substeps))  # 20 nm within one substep


def test_several_states_at_once_move_as_each_alone_bit_by_bit() -> None:
    rng = np.random.default_rng(8)
    p = plant_numbers(nominal(), T_S)
    # from one stop to the other, so that some of them hit
    states = np.array([rng.uniform(0.0, 1.5, 50), rng.uniform(0.0, 5.7e-3, 50), rng.uniform(-1.0, 1.0, 50)])
    alone = [tick(p, i, x, v, 1.7) for i, x, v in states.T.tolist()]

    ticks(p, states, 1.7)

    assert states.T.tolist() == [list(state) for state in alone]


_TRAJECTORY = """
import json
from twin.model.nominal import nominal
from twin.mirror.loop import closed_loop_tick
from twin.control import LawNumbers
from twin.simulate import plant_numbers
p = tuple(plant_numbers(nominal(), 2e-3))
c = tuple(LawNumbers(1.65, 0.49, 2.85e-3, 0.49, 1700.0, 0.0, 17.7, 17600.0, 0.0, 5.0, 1.0, 2e-3))
i = x = v = s = x_prev = 0.0
out = []
for k in range(150):
    u, i, x_next, v, s = closed_loop_tick(p, c, i, x, v, s, x_prev, 2.85e-3)
    x_prev, x = x, x_next
    out.append([u, i, x, v, s])
print(json.dumps(out))
"""


def test_compiled_and_plain_python_give_the_same_flight() -> None:
    """The same file without numba is the oracle; exp and the order of operations may differ in the last digits."""
    flights = [
        json.loads(
            subprocess.run(
                [sys.executable, "-c", _TRAJECTORY],
                env={**os.environ, "NUMBA_DISABLE_JIT": off},
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
        for off in ("0", "1")
    ]

    assert np.allclose(flights[0], flights[1], rtol=1e-9, atol=1e-13)
    assert abs(flights[0][-1][2] - 2.85e-3) < 1e-4
