"""The mirror is in step or says that it is not: gaps, resets, gain and mode changes, damaged samples, one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from protocol.bus import board51_pb2 as pb
from tests.harness.twin.rig import Rig
from twin.mirror.mirror import Mirror
from twin.mirror.output import IN_STEP, OUT_OF_STEP, SETTLING, Output
from twin.model.parameters import Model

HELD = 2.85e-3


def flying(seed: int = 1) -> tuple[Rig, Mirror]:
    """A right rig in closed loop and a mirror in step with it."""
    rig = Rig(seed=seed)
    rig.hold(HELD)
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())
    outputs = feed(mirror, rig.run(1000, HELD))
    assert outputs[-1].divergence.sync == IN_STEP
    assert outputs[-1].divergence.x_m.window_full
    return rig, mirror


def feed(mirror: Mirror, states: Iterable[pb.State]) -> list[Output]:
    return [output for output in map(mirror.handle, states) if output is not None]


def alarms(outputs: Iterable[Output], name: str) -> list[bool]:
    return [alarm.active for output in outputs for alarm in output.alarms if alarm.name == name]


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e300])
@pytest.mark.parametrize("name", ["i_lsb_a", "x_lsb_m", "u_lsb_v", "sample_time_s", "i_0_a"])
def test_parameters_with_numbers_of_no_rig_change_nothing(name: str, wrong: float) -> None:
    rig = Rig(seed=1)
    rig.hold(HELD)
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())
    parameters = rig.parameters()
    setattr(parameters, name, wrong)
    list(map(mirror.handle, rig.run(3, HELD)))

    mirror.parameters(parameters)
    outputs = feed(mirror, rig.run(200, HELD))

    assert mirror.counters["implausible_parameters"] == 1
    assert mirror.counters["samples_under_old_parameters"] == 0
    assert outputs[-1].divergence.sync == IN_STEP


def test_it_attaches_to_a_running_loop_with_the_integrator_the_board_must_have() -> None:
    rig = Rig(seed=3)
    rig.hold(HELD)
    list(rig.run(500, 3.2e-3))  # nobody listens
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())

    outputs = feed(mirror, rig.run(300, 3.2e-3))

    assert outputs[0].state is None  # the speed needs two samples
    started = outputs[1].state
    assert started is not None
    measured = started.u_c_v
    assert abs(measured - rig_input(rig)) < 0.5
    errors = [abs(o.divergence.x_m.error) for o in outputs if o.divergence.sync == IN_STEP]
    assert len(errors) > 50
    assert max(errors) < 8 * 6.5e-6  # 8 standard deviations of the coloured error


def rig_input(rig: Rig) -> float:
    return rig.i / rig.K_A


def test_it_enters_closed_loop_as_the_board_does() -> None:
    """From rest on the stop: the same lift-off in twin and rig, tick by tick."""
    rig = Rig(sigma_x_m=1e-9, sigma_i_a=1e-7, process_a=0.0, process_i=0.0, x_lsb=1e-9, i_lsb=1e-7, u_lsb=1e-4)
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())
    feed(mirror, rig.run(200, HELD))
    rig.set_mode(pb.MODE_CLOSED_LOOP)

    outputs = feed(mirror, rig.run(250, HELD))

    assert outputs[0].divergence.sync == SETTLING
    assert not alarms(outputs, OUT_OF_STEP)
    # u_lsb / sqrt(12) = 30 uV of input rounding, and one substep of uncertainty in the instant of lift-off
    assert max(abs(o.divergence.x_m.error) for o in outputs) < 5e-6
    assert outputs[-1].divergence.sync == IN_STEP


def test_a_short_gap_is_bridged_and_said_so() -> None:
    rig, mirror = flying()
    list(rig.run(10, HELD))  # lost

    outputs = feed(mirror, rig.run(100, HELD))

    first = outputs[0]
    assert first.divergence.bridged_ticks == 10
    assert first.state is not None
    assert first.state.bridged_ticks == 10
    assert first.divergence.sync == IN_STEP
    assert not first.divergence.innovation_valid
    assert outputs[1].divergence.bridged_ticks == 0
    assert not alarms(outputs, OUT_OF_STEP)
    assert max(abs(o.divergence.x_m.error) for o in outputs) < 8 * 6.5e-6
    assert mirror.counters["bridged_ticks"] == 10


def test_a_bridge_gives_what_the_lost_samples_would_have_given() -> None:
    """The twin takes only x_ref: with x_ref held, its state must not depend on what was lost."""
    rig, bridging = flying()
    _, complete = flying()
    states = list(rig.run(60, HELD))

    a = feed(complete, states)
    b = feed(bridging, states[:20] + states[27:])

    assert a[-1].state is not None
    assert b[-1].state is not None
    assert b[-1].state.x_m == a[-1].state.x_m
    assert b[-1].state.u_c_v == a[-1].state.u_c_v


@pytest.mark.parametrize(("lost", "x_ref_after"), [(11, HELD), (500, HELD), (3, 2.9e-3)])
def test_a_gap_that_cannot_be_bridged_puts_it_out_of_step(lost: int, x_ref_after: float) -> None:
    rig, mirror = flying()
    list(rig.run(lost, HELD))

    outputs = feed(mirror, rig.run(900, x_ref_after))

    first = outputs[0].divergence
    assert first.sync == OUT_OF_STEP
    assert outputs[0].state is None
    assert not first.HasField("x_m")
    assert not first.innovation_valid
    assert math.isnan(first.nis_mean)
    syncs = [o.divergence.sync for o in outputs]
    assert syncs[1] == SETTLING
    assert syncs[-1] == IN_STEP
    assert alarms(outputs, OUT_OF_STEP) == [True, False]
    full = [o.divergence.x_m.window_full for o in outputs[1:]]
    in_step_from = syncs.index(IN_STEP)
    assert full.index(True) + 1 == in_step_from + 499  # an empty window: 500 samples in step
    for output in outputs[1:in_step_from]:
        assert math.isnan(output.divergence.x_m.rolling_rmse)
    assert mirror.counters["out_of_step:lost-samples"] == 1


def test_a_reset_of_the_board_is_never_compared_across() -> None:
    _, mirror = flying()
    again = Rig(seed=9, session=2)
    mirror.parameters(again.parameters())

    outputs = feed(mirror, again.run(300, HELD))

    assert outputs[0].divergence.sync == OUT_OF_STEP
    assert outputs[-1].divergence.sync == IN_STEP
    assert alarms(outputs, OUT_OF_STEP) == [True, False]
    assert mirror.counters["out_of_step:board-reset"] == 1


def test_without_parameters_of_the_new_session_it_stays_out_of_step() -> None:
    _, mirror = flying()
    again = Rig(seed=9, session=2)
    again.hold(HELD)

    outputs = feed(mirror, again.run(300, HELD))

    assert {o.divergence.sync for o in outputs} == {OUT_OF_STEP}
    assert all(o.state is None for o in outputs)
    assert outputs[-1].divergence.innovation_valid  # the observer needs none


def test_new_gains_start_it_again_at_the_tick_they_came_into_force() -> None:
    rig, mirror = flying()
    old = rig.gains
    change_at = rig.tick + 50
    rig.gains = (0.49, 1800.0, 18.0, -17600.0)
    announced = rig.parameters(from_tick=change_at)
    rig.gains = old
    mirror.parameters(announced)

    before = feed(mirror, rig.run(50, HELD))
    rig.gains = (0.49, 1800.0, 18.0, -17600.0)
    after = feed(mirror, rig.run(900, HELD))

    assert {o.divergence.sync for o in before} == {IN_STEP}
    assert after[0].divergence.tick == change_at
    assert after[0].divergence.sync == OUT_OF_STEP
    assert after[-1].divergence.sync == IN_STEP
    errors = [o.divergence.x_m.error for o in after if o.divergence.sync == IN_STEP]
    assert max(np.abs(errors)) < 8 * 6.5e-6
    assert not alarms(after, "divergence-x")


def test_gains_that_are_announced_late_are_counted() -> None:
    rig, mirror = flying()
    rig.gains = (0.49, 1800.0, 18.0, -17600.0)

    mirror.parameters(rig.parameters(from_tick=rig.tick - 30))
    outputs = feed(mirror, rig.run(5, HELD))

    assert outputs[0].divergence.sync == OUT_OF_STEP
    assert mirror.counters["samples_under_old_parameters"] == 30


def test_repeated_parameters_change_nothing() -> None:
    rig, mirror = flying()
    again = rig.parameters(from_tick=rig.tick)
    again.host_time_ns = 7

    mirror.parameters(again)
    outputs = feed(mirror, rig.run(5, HELD))

    assert {o.divergence.sync for o in outputs} == {IN_STEP}


def test_a_change_of_mode_restarts_it_without_an_alarm() -> None:
    rig, mirror = flying()
    rig.set_mode(pb.MODE_IDLE)

    outputs = feed(mirror, rig.run(400, HELD))

    assert outputs[0].divergence.sync == SETTLING
    assert outputs[-1].divergence.sync == IN_STEP
    assert not alarms(outputs, OUT_OF_STEP)
    assert outputs[-1].state is not None
    assert outputs[-1].state.x_m == 0.0
    assert not outputs[-1].divergence.innovation_valid  # on the stop


def test_open_loop_is_driven_by_the_measured_input() -> None:
    rig = Rig(seed=4)
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())
    feed(mirror, rig.run(50, HELD))
    rig.set_mode(pb.MODE_OPEN_LOOP)
    rig.u_open = 800 * rig.u_lsb

    outputs = feed(mirror, rig.run(300, HELD))

    last = outputs[-1]
    assert last.state is not None
    assert last.state.u_c_v == rig.u_open
    assert last.state.i_c_a == pytest.approx(0.297 * rig.u_open, rel=1e-9)
    assert math.isnan(last.divergence.u_c_v.normalised)
    assert last.divergence.sync == IN_STEP


def test_a_repeated_sample_is_ignored_and_counted() -> None:
    rig, mirror = flying()
    state = rig.step(HELD)

    assert mirror.handle(state) is not None
    assert mirror.handle(state) is None
    following = mirror.handle(rig.step(HELD))

    assert following is not None
    assert following.divergence.sync == IN_STEP
    assert mirror.counters["duplicates"] == 1


def test_time_that_goes_backwards_puts_it_out_of_step() -> None:
    rig, mirror = flying()
    state = rig.step(HELD)
    state.tick -= 100

    output = mirror.handle(state)

    assert output is not None
    assert output.divergence.sync == OUT_OF_STEP
    assert mirror.counters["out_of_step:time-backwards"] == 1


@pytest.mark.parametrize(
    ("channel", "damage"),
    [("i_c_a", "absent"), ("x_m", "nan"), ("u_c_v", "inf"), ("x_ref_m", "absent"), ("x_ref_m", "nan")],
)
def test_a_sample_without_a_channel_is_counted_and_spoils_nothing(channel: str, damage: str) -> None:
    rig, mirror = flying()
    state = rig.step(HELD)
    if damage == "absent":
        state.ClearField(channel)
    else:
        setattr(state, channel, float(damage))

    output = mirror.handle(state)
    following = feed(mirror, rig.run(900, HELD))

    assert output is not None
    assert not output.divergence.innovation_valid
    assert mirror.counters[f"missing_{channel.rsplit('_', 1)[0]}"] == 1
    assert (output.divergence.sync == OUT_OF_STEP) is (channel == "x_ref_m")  # the one thing a free twin lives on
    assert following[-1].divergence.sync == IN_STEP
    assert math.isfinite(following[-1].divergence.x_m.rolling_rmse)
    assert math.isfinite(following[-1].divergence.nis_mean)


@pytest.mark.parametrize("sample_time_s", [5e-5, 0.05, -1.0])
def test_a_sample_time_the_kernels_do_not_cover_is_refused(sample_time_s: float) -> None:
    rig = Rig()
    rig.hold(HELD)
    parameters = rig.parameters()
    parameters.sample_time_s = sample_time_s
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(parameters)

    outputs = feed(mirror, rig.run(20, HELD))

    assert {o.divergence.sync for o in outputs} == {OUT_OF_STEP}
    assert all(o.state is None and math.isnan(o.divergence.nis) for o in outputs)


def test_silence_raises_the_alarm_once_and_the_next_sample_in_step_clears_it() -> None:
    rig, mirror = flying()

    (alarm,) = mirror.silence("no sample for 1 s")
    again = mirror.silence("no sample for 1 s")
    outputs = feed(mirror, rig.run(3, HELD))

    assert (alarm.name, alarm.active) == (OUT_OF_STEP, True)
    assert again == []
    assert alarms(outputs, OUT_OF_STEP) == [False]


def test_every_output_answers_the_sample_it_was_made_from() -> None:
    rig, mirror = flying()
    states = list(rig.run(20, HELD))

    for state, output in zip(states, feed(mirror, states), strict=True):
        for answer in (output.state, output.divergence):
            assert answer is not None
            assert (answer.sequence, answer.tick, answer.session, answer.t_s) == (
                state.sequence,
                state.tick,
                state.session,
                state.t_s,
            )
