"""The differential equation of a model against the steps that the twin makes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.harness.twin.exported import with_causes
from twin.model.causes.catalogue import CATALOGUE
from twin.model.extended import FIELD, I_C, RATE, SENSOR, STATES, Base, V, X
from twin.model.extension import base, vector
from twin.model.integration import advance
from twin.model.rates import rates, readings, without_equation

EQUATIONS = [cause.name for cause in CATALOGUE if not without_equation(with_causes(cause.name))]
SHORT_S = 1e-7  # its square is the error


@pytest.mark.parametrize("name", EQUATIONS)
def test_a_short_step_follows_the_rates(name: str) -> None:
    model = with_causes(name)
    p, c = base(model), vector(model.causes)
    rng = np.random.default_rng(5)
    for _ in range(20):
        i, x, v, u = rng.uniform(0.2, 1.2), rng.uniform(0.5e-3, 4.5e-3), rng.uniform(-0.05, 0.05), rng.uniform(0, 4)
        y = np.zeros(STATES)
        y[I_C], y[X], y[V], y[FIELD], y[SENSOR], y[RATE] = i, x, v, i, x, v

        advance(tuple(p), c, y, u, 0.0, SHORT_S, False)

        moved = (y[I_C] - i) / SHORT_S, (y[X] - x) / SHORT_S, (y[V] - v) / SHORT_S
        expected = rates(p, c, i, x, v, u)
        assert moved[0] == pytest.approx(expected[0], rel=2e-3, abs=0.1)
        assert moved[1] == pytest.approx(expected[1], abs=1e-4)
        assert moved[2] == pytest.approx(expected[2], rel=1e-3, abs=1e-2)


@pytest.mark.parametrize("name", ["position-sensor-gain", "current-sensor-offset", "sensor-crosstalk"])
def test_readings_are_those_of_the_twin(name: str) -> None:
    model = with_causes(name)
    p, c = base(model), vector(model.causes)
    y = np.zeros(STATES)
    y[I_C], y[X], y[FIELD] = 0.5, 2e-3, 0.5

    advance(tuple(p), c, y, 1.7, 0.0, SHORT_S, False)

    assert readings(p, c, 0.5, 2e-3)[1] == pytest.approx(y[SENSOR], abs=1e-7)


def test_what_has_no_equation_says_why() -> None:
    model = with_causes("coulomb-friction", "actuation-delay", "quadratic-drag", "eddy-current-lag")

    assert without_equation(model) == [
        "coulomb-friction: a ball that sticks follows no differential equation",
        "actuation-delay: its state is the past of a signal",
        "eddy-current-lag: it has a state beside [i_c, x, x']",
    ]
    assert isinstance(base(model), Base)
