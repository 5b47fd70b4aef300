"""A step leaves out what does not act, so each cause must be among what `is_bent` and `is_slow` look for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.model.causes.catalogue import CATALOGUE, neutral
from twin.model.causes.curve import CURVES
from twin.model.extended import STATES, Base, V, X, settle_current
from twin.model.integration import _substeps, advance

RIG = tuple(Base(K_A=0.3, T_A=4e-4, K_c=5.6e-6, b=0.02, mass_kg=8.4e-3, gravity_m_s2=9.81, x_max_m=8e-3, travel_m=6e-3))
U_V = 2.2


def vectors() -> dict[str, NDArray[np.float64]]:
    """The vector c of each cause and curve, all of its parameters at their last probe or end."""
    all_c = {"": neutral()}
    for cause in CATALOGUE:
        c = all_c[cause.name] = neutral()
        for parameter in cause.parameters:
            c[parameter.index] = parameter.probes[-1] if parameter.probes else 0.5 * (parameter.low + parameter.high)
    for curve in CURVES:
        c = all_c[curve.name] = neutral()
        first = curve.parameters[0].index
        c[first], c[first + 1], c[first + 2 : first + 10] = -5.0, 5.0, np.linspace(0.05, 0.2, 8)
    return all_c


@pytest.mark.parametrize("name", vectors())
def test_a_step_of_what_acts_is_a_step_of_everything(name: str) -> None:
    c, before = vectors()[name], np.zeros(STATES)
    settle_current(c, before, 0.75)
    before[X], before[V] = 3e-3, 0.05
    y, everything = before.copy(), before.copy()
    for _ in range(3):
        advance(RIG, c, y, U_V, 0.01, 2e-3, True)
        _substeps(RIG, c, everything, U_V, 0.01, 2e-3, True, True, True)

    assert np.all(np.isfinite(y))
    np.testing.assert_allclose(y, everything, rtol=1e-12, atol=1e-15)
