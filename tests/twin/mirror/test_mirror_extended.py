"""The twin on a model with causes, against the emulated rig that has them: in step, and quiet."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import CURRENT, INPUT, POSITION
from gateway.emulator.plant.constants import CE152
from gateway.emulator.plant.effects import EFFECTS
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Shape
from tests.harness.twin.emulated_campaign import TICK_S, Lab
from tests.harness.twin.true_model import true_model
from twin.mirror.mirror import Mirror
from twin.mirror.output import Output
from twin.model.causes.curve import CURVES
from twin.model.parameters import Model, ModelCause, Parameter
from twin.model.simulate import I_READ, X_READ, hold, left_out, plant_numbers, rig_at

GAINS = (0.49, 1700.0, 17.7, -17600.0)
MIDDLE_M = 2.85e-3
TICKS = 2600

# A way in which each place of the model shows: input, current, field, force, reading, delays, warmth.
CAUSES = ("amplifier-dead-zone", "actuation-delay", "air-gap-offset", "position-sensor-lag")
MORE_CAUSES = (
    "amplifier-gain-drift",
    "eddy-current-lag",
    "position-sensor-offset",
    "current-sensor-offset",
    "sampling-delay",
)


def flown(effects: dict[str, float]) -> tuple[pb.Parameters, list[pb.State]]:
    """Steps of 1 mm every second on the emulated rig."""
    lab = Lab(CE152, effects=effects, seed=4)
    lab.fly(MIDDLE_M)
    lab.run(300)
    span, middle = POSITION.span(0.5e-3), POSITION.to_count(MIDDLE_M)
    lab.excite(Shape.RECTANGLE, on_reference=True, amplitude=span, offset=middle, period=1000, seed=5)
    r = lab.record("flight", "closed-loop", TICKS)
    states = [
        pb.State(
            sequence=n,
            tick=n,
            session=1,
            t_s=n * TICK_S,
            i_c_a=r.i_c[n],
            x_m=r.x[n],
            u_c_v=r.u_c[n],
            x_ref_m=r.x_ref[n],
            mode=pb.MODE_CLOSED_LOOP,
        )
        for n in range(len(r.t))
    ]
    parameters = pb.Parameters(
        session=1,
        sample_time_s=TICK_S,
        law=pb.LAW_LQI,
        gains=GAINS,
        i_0_a=CE152.equilibrium_current_a(MIDDLE_M),
        x_0_m=MIDDLE_M,
        u_0_v=CE152.equilibrium_input_v(MIDDLE_M),
        u_min_v=0.0,
        u_max_v=4095 * INPUT.lsb,
        i_lsb_a=CURRENT.lsb,
        x_lsb_m=POSITION.lsb,
        u_lsb_v=INPUT.lsb,
        stream_divider=1,
    )
    return parameters, states


def watched(model: Model, parameters: pb.Parameters, states: list[pb.State]) -> list[Output]:
    mirror = Mirror(model)
    mirror.parameters(parameters)
    return [output for state in states if (output := mirror.handle(state)) is not None]


def alarms(outputs: list[Output]) -> set[str]:
    return {alarm.name for output in outputs for alarm in output.alarms if alarm.active}


def mean_nis(outputs: list[Output]) -> float:
    values = [output.divergence.nis for output in outputs if output.divergence.innovation_valid]
    assert len(values) > 0.9 * TICKS
    return float(np.mean(values))


@pytest.mark.parametrize("name", [*CAUSES, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE_CAUSES)])
def test_the_twin_of_a_rig_with_an_effect_is_quiet_once_its_model_has_it(name: str) -> None:
    """NIS of mean 2 within 4 standard errors (2 / sqrt(2600) each) and a twentieth for the rounding gains; no alarm."""
    effects = {name: EFFECTS[name].medium}
    parameters, states = flown(effects)

    plain = watched(true_model(), parameters, states)
    extended = watched(true_model(effects=effects), parameters, states)

    assert alarms(extended) == set()
    assert mean_nis(extended) == pytest.approx(2.0, abs=0.1 + 8.0 / math.sqrt(TICKS))
    # A constant on the current sensor is a constant force to the ball: the integrator and the observer hide neither.
    assert alarms(plain) != set() or mean_nis(plain) > 1.05 * mean_nis(extended)


def test_the_twin_of_a_rig_with_an_unknown_force_is_quiet_once_its_model_has_a_curve_of_it() -> None:
    force_n = EFFECTS["constant-force"].medium
    parameters, states = flown({"constant-force": force_n})
    plain = true_model()
    share = force_n / (plain.plant.mass_kg * plain.plant.gravity_m_s2)
    curve = next(item for item in CURVES if item.name == "force-over-height")
    values = {"from_x": -plain.plant.travel_m, "to_x": 2.0 * plain.plant.travel_m}
    known = {
        item.name: Parameter(value=values.get(item.name, share), unit=item.unit, method="known")
        for item in curve.parameters
    }

    extended = watched(replace(plain, causes=(ModelCause(name=curve.name, parameters=known),)), parameters, states)

    assert alarms(extended) == set()
    assert mean_nis(extended) == pytest.approx(2.0, abs=0.1 + 8.0 / math.sqrt(TICKS))


def test_readings_are_compared_with_readings() -> None:
    """An offset of 0.2 mm is in what the twin publishes, not in a divergence."""
    effects = {"position-sensor-offset": 2e-4}
    parameters, states = flown(effects)

    last = watched(true_model(effects=effects), parameters, states)[-1].state

    assert last is not None
    assert abs(last.x_m - states[-1].x_m) < 5e-5


def test_a_delay_of_whole_and_part_ticks_shifts_what_acts_and_what_shows() -> None:
    """3.5 ms late in and 2.5 ms late out: the same readings as without, 6 ms later, three ticks."""
    plain = plant_numbers(true_model(), TICK_S)
    delayed = plant_numbers(true_model(effects={"actuation-delay": 3.5e-3, "sampling-delay": 2.5e-3}), TICK_S)
    assert (delayed.act_whole, delayed.sense_whole, delayed.in_whole) == (1, 1, 3)
    u = [2.0, 2.3, 1.2, 1.9, 2.2, 2.05, 1.8, 2.1, 2.15, 2.0, 1.7, 2.2]
    rigs = [rig_at(p, i=0.6, x=1e-3, v=0.0, u=1.5) for p in (plain, delayed)]
    for rig in rigs:
        rig[:6] = 0.3, 1e-3, 0.0, 0.3, 1e-3, 0.0  # on its way down already
    readings: list[list[tuple[float, float]]] = [[], []]

    for rig, plant, inputs, which in ((rigs[0], plain, u, 0), (rigs[1], delayed, u, 1)):
        for value in inputs:
            hold(tuple(plant), rig, value)
            readings[which].append((float(rig[I_READ]), float(rig[X_READ])))

    # i_c alone has no memory of where the ball was meanwhile.
    currents = [i for i, _ in readings[0]]
    assert [i for i, _ in readings[1]][5:] == pytest.approx(currents[2:-3], rel=1e-6)


def test_a_periodic_force_is_not_simulated_and_that_is_said() -> None:
    model = true_model(effects={"periodic-disturbance": 2e-3, "air-gap-offset": 1e-4})

    assert left_out(model) == ["periodic-disturbance is not simulated: its phase is not known"]
    assert (
        plant_numbers(model, TICK_S).c[:].tolist()
        == plant_numbers(true_model(effects={"air-gap-offset": 1e-4}), TICK_S).c[:].tolist()
    )


def test_a_coil_stays_warm_through_a_change_of_mode() -> None:
    """30 s of heating are not forgotten because the twin starts anew."""
    effects = {"amplifier-gain-drift": 0.15}
    parameters, states = flown(effects)
    model = true_model(effects=effects)
    mirror = Mirror(model)
    mirror.parameters(parameters)
    for state in states:
        mirror.handle(state)
    before = float(mirror._twin[5])
    state = pb.State()
    state.CopyFrom(states[-1])
    state.tick, state.sequence, state.t_s, state.mode, state.u_c_v = TICKS, TICKS, TICKS * TICK_S, pb.MODE_IDLE, 0.0

    mirror.handle(state)

    assert before > 0.0
    assert float(mirror._twin[5]) == pytest.approx(before, rel=1e-3)
