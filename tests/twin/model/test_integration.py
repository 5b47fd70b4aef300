"""One substep for a whole interval, where the current follows slowly, against many short ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.model.causes.catalogue import CATALOGUE, neutral
from twin.model.causes.cause import NO_PLACE, Cause
from twin.model.extended import CORE, FIELD, I_C, I_SENSOR, SECOND, SENSOR, STATES, Base, V, X
from twin.model.integration import SLOW_SHARE, advance

T_S, PIECES = 2e-3, 64
# The parts of an interval leave this much of a bent reading, or of a T_A that grows near the coil.
READING_M, CURRENT_A = 5e-7, 1e-3


@pytest.mark.parametrize(
    "cause", [cause for cause in CATALOGUE if cause.strength.index != NO_PLACE], ids=lambda c: c.name
)
def test_an_interval_within_a_quarter_of_the_time_constant_is_exact(cause: Cause) -> None:
    draw, c = np.random.default_rng(5), neutral()
    strength = cause.strength
    c[strength.index] = strength.value(strength.coordinate(strength.probes[-1]))
    p = Base(0.297, 1.02 * T_S / SLOW_SHARE, 2.751e-6, 0.02, 8.28e-3, 9.81, 5.7e-3, 5.7e-3)

    for _ in range(20):
        gap = draw.uniform(1.5e-3, 5e-3)
        held_a = math.sqrt(p.mass_kg * p.gravity_m_s2 / p.K_c) * gap
        y = np.zeros(STATES)
        y[[I_C, FIELD, SECOND, CORE, I_SENSOR]] = held_a * draw.uniform(0.7, 1.3)
        y[[X, SENSOR]], y[V] = p.x_max_m - gap, draw.uniform(-0.1, 0.1)
        u = held_a * draw.uniform(0.5, 1.6) / p.K_A
        pieces = y.copy()

        advance(tuple(p), c, y, u, 0.0, T_S, False)
        for k in range(PIECES):
            advance(tuple(p), c, pieces, u, k * T_S / PIECES, T_S / PIECES, False)

        assert y[X] == pytest.approx(pieces[X], abs=6e-8)
        assert y[SENSOR] == pytest.approx(pieces[SENSOR], abs=READING_M)
        assert y[[I_C, I_SENSOR]] == pytest.approx(pieces[[I_C, I_SENSOR]], abs=CURRENT_A)
