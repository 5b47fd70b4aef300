"""Gains, margins and rms against computations of another kind: Riccati recursion, brute force, simulation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from protocol.bus import board51_pb2 as pb
from protocol.errors import UsageError
from tests.harness.twin.one_tick import tick
from twin.control import law, law_numbers, linearise
from twin.control_design.board import Converters
from twin.control_design.design import Design, Specification, design
from twin.control_design.gains import Weights, in_order_of
from twin.control_design.loop import Plant, backward, closed_loop
from twin.control_design.robust import plant_at
from twin.model.linear import discretised
from twin.model.parameters import Model
from twin.model.simulate import plant_numbers

T_S = 2e-3
COIL_PLANE_ABOVE_STOP_M = 2.44e-3


def coil_higher() -> Model:
    """The four equilibria of a CE 152 behind the shipped K_c: same lift-off, coil plane above the top stop."""
    model = Model.load("ce152")
    x_max = model.plant.travel_m + COIL_PLANE_ABOVE_STOP_M
    K_c = model.parameters["K_c"]
    same_lift_off = dataclasses.replace(K_c, value=K_c.value * (x_max / model.plant.x_max_m) ** 2)
    return dataclasses.replace(
        model,
        plant=dataclasses.replace(model.plant, x_max_m=x_max),
        parameters={**model.parameters, "K_c": same_lift_off},
    )


def uncertain(share: float) -> Model:
    model = Model.load("ce152")
    return dataclasses.replace(
        model,
        parameters={
            name: dataclasses.replace(p, ci95=(p.value * (1 - share), p.value * (1 + share)))
            for name, p in model.parameters.items()
        },
    )


def K_of(result: Design) -> tuple[float, float, float, float]:
    k_i, k_x, k_v, k_int = result.gains
    return k_i, k_x, k_v, k_int


def test_gains_are_those_of_the_riccati_equation() -> None:
    model = Model.load("ce152")

    result = design(model)

    # (14)-(16) written out once more, in mm and 10 mA so that the solver works on other numbers.
    m, x0 = model.plant.mass_kg, 0.5 * model.plant.travel_m
    gap = model.plant.x_max_m - x0
    i0 = gap * math.sqrt(m * 9.81 / model.K_c)
    block = np.zeros((4, 4))
    block[0] = [-1 / model.T_A, 0, 0, model.K_A / model.T_A]
    block[1, 2] = 1
    block[2, :3] = [2 * 9.81 / i0, 2 * 9.81 / gap, -model.b / m]
    step = expm(block * T_S)
    A, B = np.eye(4), np.zeros((4, 1))
    A[:3, :3], B[:3, 0], A[3, 1] = step[:3, :3], step[:3, 3], -T_S
    scale = np.array([1e-2, 1e-3, 1e-3, 1e-3])
    scaled, entry = A * scale[None, :] / scale[:, None], B / scale[:, None]
    Q = np.diag(np.array(result.weights.Q) * scale**2)
    P = solve_discrete_are(scaled, entry, Q, np.array([[result.weights.R]]))
    K = np.linalg.solve(result.weights.R + entry.T @ P @ entry, entry.T @ P @ scaled)[0] / scale
    np.testing.assert_allclose(result.gains, K, rtol=1e-6)


@pytest.mark.parametrize("plant", ["nominal", "coil higher", "coil higher, K_c kept"])
@pytest.mark.parametrize(("law_name", "designed_on"), [("lqi", "nominal"), ("lqi", "coil higher"), ("pid", "nominal")])
def test_the_gains_settle_a_step_of_half_a_millimetre(law_name: str, plant: str, designed_on: str) -> None:
    models = {"nominal": Model.load("ce152"), "coil higher": coil_higher()}
    models["coil higher, K_c kept"] = dataclasses.replace(models["nominal"], plant=models["coil higher"].plant)
    result = design(models[designed_on], Specification(law="pid" if law_name == "pid" else "lqi"))
    c = law_numbers(
        pb.Parameters(
            law=pb.LAW_PID if law_name == "pid" else pb.LAW_LQI,
            gains=[gain.value for gain in result.quantised],
            i_0_a=result.point.i_a,
            x_0_m=result.point.x_m,
            u_0_v=result.point.u_v,
            u_max_v=5.0,
            sample_time_s=T_S,
            x_lsb_m=1.43e-6,
        )
    )
    assert c is not None
    numbers = plant_numbers(models[plant], T_S)
    x_0 = result.point.x_m
    i, x, v, s, x_prev = result.point.i_a, x_0, 0.0, 0.0, x_0
    errors_m = []

    for k in range(2000):
        x_ref = x_0 if k < 1000 else x_0 + 0.5e-3
        u, s = law(c, i, x, x_prev, s, x_ref)
        x_prev = x
        i, x, v = tick(numbers, i, x, v, u)
        if k >= 1750:
            errors_m.append(abs(x - x_ref))

    assert max(errors_m) < 0.02 * 0.5e-3  # settled to 2 % within 1.5 s


def test_margins_are_where_the_loop_really_goes_unstable() -> None:
    model = Model.load("ce152")
    result = design(model)
    A, B = linearise(model, result.point.x_m)
    K = K_of(result)
    loop = result.loops[1]
    assert loop.margins is not None

    def spectral_radius(factor: float, delay_ticks: int) -> float:
        controller = backward((K[0] * factor, K[1] * factor, K[2] * factor, K[3] * factor), T_S)
        F = closed_loop(plant_at(model, result.point.x_m, T_S), controller)
        n = len(F)
        if delay_ticks == 0:
            return float(np.max(np.abs(np.linalg.eigvals(F))))
        plant = plant_at(model, result.point.x_m, T_S)
        whole = np.zeros((n + delay_ticks, n + delay_ticks))
        whole[:n, :n] = closed_loop(plant._replace(gamma=np.zeros((3, 1))), controller)
        whole[:3, n + delay_ticks - 1 : n + delay_ticks] = plant.gamma
        whole[n, :n] = np.hstack([controller.D, controller.C])[0]
        whole[n + 1 :, n:-1] = np.eye(delay_ticks - 1)
        return float(np.max(np.abs(np.linalg.eigvals(whole))))

    assert spectral_radius(loop.margins.gain_high * 0.999, 0) < 1 < spectral_radius(loop.margins.gain_high * 1.001, 0)
    assert spectral_radius(loop.margins.gain_low * 1.001, 0) < 1 < spectral_radius(loop.margins.gain_low * 0.999, 0)
    whole = int(loop.margins.delay_s / T_S)
    assert spectral_radius(1.0, whole) < 1 < spectral_radius(1.0, whole + 1)
    # A part of a tick: the same response as the plant run on a grid twenty times finer.
    for delay_s in (0.7e-3, 3.1e-3):
        delayed = Plant(*discretised(A, B, delay_s, T_S))
        oversampled = Plant(*discretised(A, B, 0.0, T_S / 20))
        p, q = np.zeros(len(delayed.phi)), np.zeros(3)
        inputs = np.random.default_rng(3).normal(size=8)
        for k in range(8 * 20):
            if k % 20 == 0:
                p = delayed.phi @ p + delayed.gamma[:, 0] * inputs[k // 20]
            shifted = k - round(delay_s / T_S * 20)
            q = oversampled.phi @ q + oversampled.gamma[:, 0] * (inputs[shifted // 20] if shifted >= 0 else 0.0)
        np.testing.assert_allclose(p[:3], q, rtol=1e-9)


def test_phase_margin_is_the_one_of_python_control() -> None:
    import control

    model = Model.load("ce152")
    result = design(model)
    plant, c = plant_at(model, result.point.x_m, T_S), backward(K_of(result), T_S)
    loop = control.ss(c.A, c.B, -c.C, -c.D, T_S) * control.ss(plant.phi, plant.gamma, np.eye(3), np.zeros((3, 1)), T_S)

    _, phases, *_ = control.stability_margins(loop, returnall=True, method="frd", epsw=1e-3)

    margins = result.loops[1].margins
    assert margins is not None
    assert margins.phase_deg == pytest.approx(np.min(np.abs(phases)), abs=0.3)


@pytest.mark.parametrize("which", [2, 3])
def test_rms_is_what_a_simulation_with_that_noise_shows(which: int) -> None:
    model, converters = Model.load("ce152"), Converters()
    result = design(model, Specification(with_observer=True))
    phi, gamma = plant_at(model, result.point.x_m, T_S)
    K = np.array([gain.value for gain in result.quantised] if which == 2 else result.gains)
    rng = np.random.default_rng(5)
    p, s, x_prev, guess = np.zeros(3), 0.0, 0.0, np.zeros(3)
    xs, us = [], []

    for _ in range(30_000):
        i_y = round((p[0] + rng.normal(0, model.noise.sigma_i_c_a)) / converters.i_lsb_a) * converters.i_lsb_a
        x_y = round((p[1] + rng.normal(0, model.noise.sigma_x_m)) / converters.x_lsb_m) * converters.x_lsb_m
        if which == 2:
            u = -K @ [i_y, x_y, (x_y - x_prev) / T_S, s]
        else:
            assert result.observer_gain is not None
            filtered = guess + result.observer_gain @ (np.array([i_y, x_y]) - guess[:2])
            u = -K @ [*filtered, s]
            guess = phi @ filtered + gamma[:, 0] * u
        s, x_prev = s - T_S * x_y, x_y
        xs.append(p[1])
        u = round(u / converters.u_lsb_v) * converters.u_lsb_v
        us.append(u)
        p = phi @ p + gamma[:, 0] * u
        p += np.array([rng.normal(0, model.noise.process_i_c_a), 0, rng.normal(0, model.noise.process_a_m_s2 * T_S)])

    # The slowest mode (56 ms) leaves 30 000 / (2 * 28) = 540 independent samples: std of an rms 3.0 %; 4 of them.
    assert np.std(us) == pytest.approx(result.loops[which].u_rms_v, rel=0.12)
    assert np.std(xs) == pytest.approx(result.loops[which].x_rms_m, rel=0.12)


def test_a_wide_interval_is_warned_of_and_a_narrow_one_is_not() -> None:
    narrow, wide = design(uncertain(0.02)), design(uncertain(0.7))

    assert narrow.robustness.unstable_share == 0.0
    assert not narrow.warnings
    assert wide.robustness.unstable_share > 0.0
    assert wide.robustness.worst_pole > 1.0
    assert any("could destabilise" in warning for warning in wide.warnings)
    assert wide.robustness == design(uncertain(0.7)).robustness


def test_pid_counts_its_integral_positive() -> None:
    assert in_order_of("pid", (0.0, 1700.0, 17.0, -9000.0)) == (1700.0, 9000.0, 17.0, 0.0)


def test_a_gain_beyond_the_format_is_refused() -> None:
    with pytest.raises(UsageError, match="board's largest"):
        design(Model.load("ce152"), Specification(converters=Converters(u_lsb_v=1e-9)))


@pytest.mark.parametrize(
    ("Q", "R", "expected"),
    [
        ((1.0, 1.0, 1.0, 0.0), 1.0, "integral"),
        ((1.0, -1.0, 1.0, 1.0), 1.0, "weight of x"),
        ((1.0, 1.0, 1.0, 1.0), 0.0, "R is 0"),
        ((1.0, 1.0, 1.0, 1.0), math.nan, "nan"),
    ],
)
def test_weights_that_are_none_are_refused(Q: tuple[float, float, float, float], R: float, expected: str) -> None:
    with pytest.raises(UsageError, match=expected):
        Weights(Q=Q, R=R)
