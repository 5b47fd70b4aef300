"""The coil switched off in flight, the fall, the landing and the next lift-off: no alarm under the right model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import CURRENT, INPUT, POSITION
from gateway.emulator.plant.constants import CE152, PlantConstants
from protocol.bus import board51_pb2 as pb
from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import HostLoss, Mode
from tests.harness.twin.emulated_campaign import TICK_S, Lab
from tests.harness.twin.true_model import true_model
from twin.mirror.mirror import Mirror
from twin.mirror.output import Output
from twin.model.parameters import Model

MODES = {Mode.IDLE: pb.MODE_IDLE, Mode.OPEN_LOOP: pb.MODE_OPEN_LOOP, Mode.CLOSED_LOOP: pb.MODE_CLOSED_LOOP}
FLOWN, FALLEN = 600, 250  # ticks: two windows are begun; a fall from the top and its bounces


class Flight:
    """States of an emulated rig in flight at `x_m`, as the gateway publishes them."""

    def __init__(
        self, x_m: float, *, seed: int, rig: PlantConstants = CE152, effects: Mapping[str, float] | None = None
    ) -> None:
        self.states: list[pb.State] = []
        self.lab = Lab(rig, effects=dict(effects or {}), seed=seed)
        self.lab.fly(x_m)
        self.run(FLOWN)

    def run(self, ticks: int) -> list[pb.State]:
        """Run and return the states of these ticks, and of a command before them."""
        record = self.lab.states(ticks)
        new = [
            pb.State(
                sequence=sample.sequence,
                tick=sample.sequence,
                session=1,
                t_s=sample.sequence * TICK_S,
                i_c_a=CURRENT.to_si(sample.i_c),
                x_m=POSITION.to_si(sample.x),
                u_c_v=INPUT.to_si(sample.u_c),
                x_ref_m=POSITION.to_si(sample.x_ref),
                mode=MODES[Mode(sample.flags & 3)],
                flags=sample.flags & ~3,
            )
            for sample in record
        ]
        self.states += new
        return new

    def switch_off(self, how: str, *, into_tick_us: int = 0) -> int:
        """Switch off and let the ball fall; returns the tick of the first sample in idle."""
        if how == "stop":
            self.lab.firmware.feed(encode_frame(encode_body("STOP", id=255)), into_tick_us=into_tick_us)
        elif how == "host-loss":
            self.lab.request("SET_HOST_LOSS", policy=int(HostLoss.COIL_OFF), timeout=100)
        else:
            self.lab.request("SET_MODE", mode=int(Mode.IDLE))
        return next(state.tick for state in self.run(FALLEN) if state.mode == pb.MODE_IDLE)


def watched(model: Model, states: list[pb.State]) -> list[Output]:
    """Return the outputs of an observer of `model`.

    Without the board's parameters there is no free twin, which is not tested.
    """
    mirror = Mirror(model)
    return [output for state in states if (output := mirror.handle(state)) is not None]


def alarms(outputs: list[Output]) -> list[tuple[str, int]]:
    return [(alarm.name, alarm.tick) for output in outputs for alarm in output.alarms if alarm.active]


def valid_nis(outputs: list[Output], *, since: int) -> list[float]:
    return [o.divergence.nis for o in outputs if o.divergence.innovation_valid and o.divergence.tick >= since]


@pytest.mark.parametrize(
    ("how", "x_m"), [("stop", 0.6e-3), ("stop", 2.85e-3), ("stop", 5.1e-3), ("host-loss", 1.4e-3), ("idle", 4.5e-3)]
)
def test_a_coil_switched_off_in_flight_raises_no_alarm(how: str, x_m: float) -> None:
    """At any instant of the tick; the fall is judged, not left out."""
    for seed in range(3):
        flight = Flight(x_m, seed=seed)
        off = flight.switch_off(how, into_tick_us=int(np.random.default_rng(seed).integers(0, 2000)))

        outputs = watched(true_model(), flight.states)

        assert alarms(outputs) == [], seed
        fall = valid_nis(outputs, since=off)
        assert len(fall) >= 4, seed
        # chi-square with 2 degrees: 1e-9 of its values are above 42
        assert max(fall) < 42.0, (seed, fall)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])
def test_a_landing_raises_no_alarm_however_the_ball_bounces(restitution: float) -> None:
    """Some samples are taken after the bounce, well above the stop."""
    rig = replace(CE152, restitution=restitution)
    for seed, x_m in enumerate(np.linspace(1e-3, 5.1e-3, 4)):
        flight = Flight(float(x_m), seed=seed, rig=rig)
        flight.switch_off("stop", into_tick_us=500 * seed)

        assert alarms(watched(true_model(rig), flight.states)) == [], (seed, x_m)


def test_the_flight_after_a_bounce_is_judged_and_predicted() -> None:
    """A landing is no mute window: the restitution is unknown for one sample, then the readings tell the speed."""
    rig = replace(CE152, restitution=0.9)
    flight = Flight(2.76e-3, seed=3, rig=rig)
    off = flight.switch_off("stop", into_tick_us=750)
    landing = next(b.tick for a, b in pairwise(flight.states) if b.tick > off + 2 and b.x_m > a.x_m)

    hop = valid_nis(watched(true_model(rig), flight.states), since=landing)

    assert len(hop) >= 15  # 0.2 m/s up and down again: 40 ms, without the sample at the stop
    assert max(hop) < 42.0


@pytest.mark.parametrize(
    "effects",
    [
        {"actuation-delay": 1.3e-3},
        {"sampling-delay": 2e-3},
        {"actuation-delay": 1.5e-3, "sampling-delay": 1.5e-3},
        {"position-sensor-lag": 2e-3},
        {"eddy-current-lag": 1e-3},
        {"position-sensor-offset": 2e-4},
    ],
    ids=lambda effects: "+".join(effects),
)
def test_a_model_with_causes_is_quiet_in_a_fall_too(effects: Mapping[str, float]) -> None:
    for seed in range(2):
        flight = Flight(2.85e-3, seed=seed, effects=effects)
        flight.switch_off("stop", into_tick_us=300 + 1100 * seed)

        assert alarms(watched(true_model(CE152, effects), flight.states)) == [], seed


def test_a_rig_of_another_day_with_a_slow_amplifier_is_quiet() -> None:
    rig = replace(CE152, amplifier_time_constant_s=1.5e-3, force_constant_n_m2_a2=4.9e-6)
    for seed in range(2):
        flight = Flight(2e-3, seed=seed, rig=rig)
        flight.switch_off("stop", into_tick_us=900 * seed)

        assert alarms(watched(true_model(rig), flight.states)) == [], seed


def test_lift_offs_and_falls_in_turn_raise_no_alarm() -> None:
    flight = Flight(2.85e-3, seed=7)
    for into_tick_us in (100, 900, 1900):
        flight.switch_off("stop", into_tick_us=into_tick_us)
        flight.lab.request("SET_MODE", mode=int(Mode.CLOSED_LOOP))
        flight.run(FLOWN)

    assert flight.states[-1].x_m == pytest.approx(2.85e-3, abs=1e-4)
    assert alarms(watched(true_model(), flight.states)) == []


def test_a_wrong_force_raises_the_alarm_in_flight() -> None:
    flight = Flight(2.85e-3, seed=3)
    off = flight.switch_off("stop", into_tick_us=800)
    wrong = true_model(replace(CE152, force_constant_n_m2_a2=1.2 * CE152.force_constant_n_m2_a2))

    raised = alarms(watched(wrong, flight.states))

    assert [name for name, tick in raised if tick < off] == ["innovation"]


def test_a_coil_that_stays_on_after_a_stop_raises_the_alarm() -> None:
    """The board says u_c = 0 and the current stays: seen by the second sample after the STOP."""
    flight = Flight(2.85e-3, seed=3)
    plant = flight.lab.plant
    held_v, advance = flight.states[-1].u_c_v, plant.advance
    plant.advance = lambda u_v, duration_s: advance(max(u_v, held_v), duration_s)  # type: ignore[method-assign]  # the fault
    off = flight.switch_off("stop", into_tick_us=800)

    raised = alarms(watched(true_model(), flight.states))

    assert raised[0] == ("innovation", off + 1)


def test_a_fall_that_the_model_does_not_predict_raises_the_alarm() -> None:
    """Weight and force wrong by the same share: right at rest, and wrong by 1 m/s^2 without current."""
    flight = Flight(5.1e-3, seed=3)
    off = flight.switch_off("stop", into_tick_us=800)
    share = 1.0 - 1.0 / CE152.gravity_m_s2
    wrong = true_model(
        replace(
            CE152,
            gravity_m_s2=share * CE152.gravity_m_s2,
            force_constant_n_m2_a2=share * CE152.force_constant_n_m2_a2,
        )
    )

    raised = alarms(watched(wrong, flight.states))

    assert [name for name, tick in raised if tick >= off] == ["innovation"]
