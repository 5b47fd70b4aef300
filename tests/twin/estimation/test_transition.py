"""The step of the filter against an integration as fine as one likes, and compiled against plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X, run_filter
from twin.estimation.structures import NoiseLevels
from twin.estimation.transition import Physics, moments, transit


def plain(function: object) -> object:
    return getattr(function, "py_func", function)


def fine(p: Physics, T_s: float, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """Midpoint rule in steps of T_s/20000: error of order (T_s/20000)^2."""
    h = T_s / 20_000
    e = p.K_A * u
    for n in range(20_000):
        i_mid = e + (i - e) * math.exp(-(n + 0.5) * h / p.T_A)
        a = p.k * i_mid**2 / (p.x_max_m - x - 0.5 * h * v) ** 2 - p.d * v - p.gravity_m_s2
        x, v = x + h * v + 0.5 * h * h * a, v + h * a
    return e + (i - e) * math.exp(-T_s / p.T_A), x, v


@pytest.mark.parametrize("T_A", [2e-5, 3e-4, 2e-3, 3e-2])
@pytest.mark.parametrize("T_s", [5e-4, 2e-3, 3e-3])
def test_one_interval_is_the_solution_of_the_equations(T_A: float, T_s: float) -> None:
    p = Physics(K_A=0.3, T_A=T_A, k=6.8e-4, d=2.5, gravity_m_s2=9.81, x_max_m=8.1e-3, gap_min_m=5.7e-5, travel_m=5.7e-3)
    m = np.empty(9)
    moments(T_s, T_A, m)

    got = transit(p, m, T_s, 0.7, 2.9e-3, 0.1, 2.0)

    want = fine(p, T_s, 0.7, 2.9e-3, 0.1, 2.0)
    # The parabola through 1/gap^2 misses its third derivative: x'' is off by about k i^2 (24 v^3 / gap^5) T_s^3 / 200.
    error = 6.8e-4 * 0.49 * 24 * 0.1**3 / 5.2e-3**5 * T_s**3 / 200
    assert got[0] == pytest.approx(want[0], abs=1e-12)
    assert abs(got[1] - want[1]) < max(error * T_s * T_s, 1e-11)
    assert abs(got[2] - want[2]) < max(10.0 * error * T_s, 1e-8)


@pytest.mark.parametrize("T_A", [1e-5, 1e-3, 0.1, 10.0])
def test_moments_do_not_cancel(T_A: float) -> None:
    T_s = 2e-3
    m = np.empty(9)
    moments(T_s, T_A, m)

    t, w = np.polynomial.legendre.leggauss(400)
    t, w = 0.5 * T_s * (t + 1.0), 0.5 * T_s * w
    for j in range(4):
        assert m[j] == pytest.approx(float(np.sum(w * t**j * np.exp(-t / T_A))), rel=1e-9)
        assert m[4 + j] == pytest.approx(float(np.sum(w * t**j * np.exp(-2 * t / T_A))), rel=1e-9)


def test_compiled_and_plain_filter_agree() -> None:
    rng = np.random.default_rng(1)
    n = 60
    flags = np.full(n, FOLLOWS | FLIES | USE_I | USE_X, np.uint8)
    flags[0] &= ~FOLLOWS & 0xFF
    flags[10] &= ~USE_X & 0xFF
    flags[20] &= ~USE_I & 0xFF
    flags[30:34] &= ~FLIES & 0xFF
    numbers = (0.3, 3e-4, 6.8e-4, 2.5, 9.81, 8.1e-3, 5.7e-5, 5.7e-3)
    inputs = (
        numbers,
        NoiseLevels(2e-3, 5e-6, 1e-4, 0.02, 2e-3),
        np.full(n, 2e-3),
        2.1 + 0.01 * rng.normal(size=n),
        0.63 + 2e-3 * rng.normal(size=n),
        2.9e-3 + 5e-6 * rng.normal(size=n),
        flags,
    )
    compiled, interpreted = np.empty((n, 5)), np.empty((n, 5))

    run_filter(*inputs, compiled, np.empty((n, 3)))
    plain(run_filter)(*inputs, interpreted, np.empty((n, 3)))  # type: ignore[operator]  # numba is untyped

    np.testing.assert_allclose(compiled, interpreted, rtol=1e-9, atol=1e-15)
    assert np.isnan(compiled[10, 1])
    assert np.isnan(compiled[20, 0])
