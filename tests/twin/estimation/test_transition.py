"""The closed form of one interval against an integration as fine as one likes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.estimation.ekf.transition import moments, transit
from twin.model.extended import Base


def integrate(p: Base, T_s: float, i: float, x: float, v: float, u: float) -> tuple[float, float, float]:
    """Midpoint rule in steps of T_s/20000: error of order (T_s/20000)^2."""
    h = T_s / 20_000
    e = p.K_A * u
    for n in range(20_000):
        i_mid = e + (i - e) * math.exp(-(n + 0.5) * h / p.T_A)
        a = p.K_c / p.mass_kg * i_mid**2 / (p.x_max_m - x - 0.5 * h * v) ** 2 - p.b / p.mass_kg * v - p.gravity_m_s2
        x, v = x + h * v + 0.5 * h * h * a, v + h * a
    return e + (i - e) * math.exp(-T_s / p.T_A), x, v


@pytest.mark.parametrize("T_A", [2e-5, 3e-4, 2e-3, 3e-2])
@pytest.mark.parametrize("T_s", [5e-4, 2e-3, 3e-3])
def test_one_interval_is_the_solution_of_the_equations(T_A: float, T_s: float) -> None:
    m = 0.0118
    p = Base(K_A=0.3, T_A=T_A, K_c=6.8e-4 * m, b=2.5 * m, mass_kg=m, gravity_m_s2=9.81, x_max_m=8.1e-3, travel_m=5.7e-3)
    integrals = np.empty(9)
    moments(T_s, T_A, integrals)

    got = transit(p, integrals, T_s, 0.7, 2.9e-3, 0.1, 2.0)

    want = integrate(p, T_s, 0.7, 2.9e-3, 0.1, 2.0)
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
