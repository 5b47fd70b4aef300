"""Designs on models with causes, flown by the emulated board on the rig that has these effects."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import board51
from gateway.emulator.firmware_model.flash import POSITION
from gateway.emulator.plant.constants import CE152
from protocol.wire.messages import Shape
from tests.harness.twin.emulated_campaign import Lab
from tests.harness.twin.true_model import true_model
from twin.control import discrete, linearise
from twin.control_design.design import Design, design
from twin.model.equilibrium import equilibrium
from twin.model.linear import linearise as numerically

T_S = 2e-3
MIDDLE_M = 2.85e-3
DELAYS = {"actuation-delay": 2e-3, "position-sensor-lag": 2.5e-3, "eddy-current-lag": 1.5e-3}


def error_m(effects: dict[str, float], made: Design) -> float:
    """rms of x_ref - x on the emulated rig under these gains, steps of 0.6 mm."""
    lab = Lab(CE152, effects=effects, seed=3)
    point = made.point
    lab.close_loop(made.gains, (point.i_a, point.x_m, point.u_v), i_c_a=CE152.equilibrium_current_a(MIDDLE_M))
    lab.run(300)
    span, middle = POSITION.span(0.3e-3), POSITION.to_count(MIDDLE_M)
    lab.excite(Shape.RECTANGLE, on_reference=True, amplitude=span, offset=middle, period=500, seed=1)
    record = lab.record("flight", "closed-loop", 2000)
    return float(np.sqrt(np.mean((record.x_ref - record.x) ** 2)))


@pytest.mark.parametrize("x_m", [1e-3, MIDDLE_M, 4.5e-3])
def test_the_linearisation_of_the_kernel_is_the_papers_14(x_m: float) -> None:
    """Central differences of steps of 1e-4 of what there is: squares of that, and rounding over the step, are left."""
    model = true_model()

    for exact, approximate in zip(linearise(model, x_m), numerically(model, x_m), strict=True):
        assert np.allclose(approximate, exact, rtol=1e-5, atol=1e-6 * np.max(np.abs(exact)))


def test_gains_designed_with_the_delays_fly_where_those_without_drop_the_ball() -> None:
    """Largest pole on the model: 1.11 without, 0.97 with; so on the emulated rig, whose delays are its own."""
    extended = true_model(effects=DELAYS)
    plain = design(replace(extended, causes=()))
    aware = design(extended)

    assert aware.board.stable
    assert abs(aware.board.poles[0]) < 0.98
    assert error_m(DELAYS, aware) < 0.25e-3
    assert error_m(DELAYS, plain) > 1.0e-3


def test_the_operating_point_is_where_the_rig_with_its_causes_rests() -> None:
    """The emulator's own equilibrium with the coil 0.8 mm higher and a sensor that reads 0.2 mm too high."""
    effects = {"air-gap-offset": 8e-4, "position-sensor-offset": 2e-4, "amplifier-dead-zone": 0.15}
    higher = replace(CE152, coil_plane_above_stop_m=CE152.coil_plane_above_stop_m + 8e-4)

    i, u = equilibrium(true_model(effects=effects), MIDDLE_M)

    assert i == pytest.approx(higher.equilibrium_current_a(MIDDLE_M - 2e-4), rel=1e-9)
    assert u == pytest.approx(higher.equilibrium_input_v(MIDDLE_M - 2e-4) + 0.15, rel=1e-9)


def test_delays_are_states_of_the_discrete_model() -> None:
    model = true_model(effects={"actuation-delay": 1e-3, "sampling-delay": 2e-3})

    phi, gamma = discrete(model, MIDDLE_M, T_S)

    assert phi.shape == (5, 5)
    assert np.allclose(gamma[:3], 0.0)  # what is sent now acts 3 ms later
    assert np.allclose(phi[:3, 3], discrete(true_model(effects={"actuation-delay": 1e-3}), MIDDLE_M, T_S)[1][:3, 0])


def test_the_command_says_what_the_causes_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "extended_model.json"
    path.write_text(json.dumps(true_model(effects={"air-gap-offset": 8e-4, "coulomb-friction": 2e-3}).to_json()))

    assert board51.main(["design", str(path), "--json"]) == 0

    report = json.loads(capsys.readouterr().out)
    causes_text = "\n".join(report["causes"])
    assert "air-gap-offset: the coil's plane is higher than x_max (d = 0.0008 m)" in causes_text
    assert "without them: i_c = 0.6365 A and u_c = 2.1430 V" in causes_text
    assert "dry friction is left out" in causes_text
    assert "air-gap-offset.d_m" in report["robustness"]["varied"]
