"""Two heights on the emulated board: its own plant, firmware and counts; a hidden lag is told, a right model passes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import POSITION
from gateway.emulator.plant.constants import CE152
from protocol.campaign import Controller, OperatingPoint
from protocol.wire.messages import Shape
from tests.harness.twin.emulated_campaign import TICK_S, Lab
from tests.harness.twin.true_model import true_model
from twin.estimation.record import Record
from twin.frequency.bode import Bode, bode_of
from twin.validation.source import source_of

pytestmark = pytest.mark.slow
TRAVEL = CE152.travel_m
HEIGHTS = (0.35 * TRAVEL, 0.65 * TRAVEL)


def flown(effects: dict[str, float], x_m: float, seed: int) -> tuple[Record, Controller]:
    """The experiments `bode-low` and `bode-high`, under the law that `Lab.fly` loads."""
    lab = Lab(CE152, effects=effects, seed=seed)
    lab.fly(x_m)
    lab.run(500)
    at = POSITION.to_count(x_m)
    slow, fast = POSITION.span(0.04 * TRAVEL), POSITION.span(0.02 * TRAVEL)
    lab.excite(Shape.MULTISINE, amplitude=slow, period=round(1.0 / TICK_S), on_reference=True, offset=at, seed=4)
    first = lab.record(f"slow {x_m * 1e3:.2f}", "closed-loop", round(12.0 / TICK_S))
    lab.excite(Shape.MULTISINE, amplitude=fast, period=round(0.25 / TICK_S), on_reference=True, offset=at, seed=4)
    second = lab.record("fast", "closed-loop", round(20.0 / TICK_S))
    point = OperatingPoint(i_c_a=CE152.equilibrium_current_a(x_m), x_m=x_m, u_c_v=CE152.equilibrium_input_v(x_m))
    law = Controller(kind="lqi", gains=(0.49, 1700.0, 17.7, -17600.0), operating_point=point)
    return joined(first, second), law


def joined(first: Record, second: Record) -> Record:
    return replace(
        first,
        use="judge",
        t=np.append(first.t, second.t),
        u_c=np.append(first.u_c, second.u_c),
        i_c=np.append(first.i_c, second.i_c),
        x=np.append(first.x, second.x),
        x_ref=np.append(first.x_ref, second.x_ref),
    )


def compared(effects: dict[str, float], seed: int) -> Bode:
    model = true_model()
    several = [flown(effects, x, seed + n) for n, x in enumerate(HEIGHTS)]
    return bode_of([source_of(record, model, controller=law) for record, law in several], model)


def test_a_right_model_explains_both_heights() -> None:
    result = compared({}, seed=1)

    assert result.verdict.explains, result.verdict.sentence
    assert len(result.heights) == 2
    assert result.verdict.to_hz > 15.0
    for height in result.heights:
        modulus, modelled = height.margins["modulus"], height.model_margins["modulus"]
        assert modulus.low - 0.1 < modelled.value < modulus.high + 0.1


def test_a_hidden_sensor_lag_is_named_at_its_size() -> None:
    result = compared({"position-sensor-lag": 2e-3}, seed=5)

    assert result.verdict.explains is False
    assert "phase of the plant (u_c to x) lags" in result.verdict.sentence
    for test in result.verdict.tests:
        if test.name == "plant":
            lag = next(form for form in test.forms if form.kind == "lag")
            assert 1.5e-3 < lag.value < 2.5e-3
        assert not (test.name == "amplifier" and test.failed)
