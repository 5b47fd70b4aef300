from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from protocol.wire.messages import Shape
from tests.harness.diagnose.simulated_rig import (
    ITEMS,
    MIDDLE_M,
    PLANT,
    THETA,
    TICK_S,
    controller,
    criterion_of,
    made,
    narrow,
    rig_of,
    strong,
)
from tests.harness.twin.emulated_campaign import Lab
from twin.diagnosis.experiments.closed_loop import Converters, Rig, converters_of
from twin.diagnosis.experiments.designed_law import lift_off_input
from twin.diagnosis.experiments.schedules import MENU
from twin.diagnosis.experiments.virtual_recordings import Schedule, input_limit, resimulate, simulate
from twin.estimation.innovations import FLIES
from twin.estimation.record import Record
from twin.evidence.sensor_noise import sensor_noise
from twin.model.causes.catalogue import BY_NAME, CATALOGUE

STRENGTHS = {  # clear effects under which the loop still holds the ball; others: their first probe
    "amplifier-gain-drift": 0.05,
    "current-limit": 0.75,
    "slew-rate-limit": 300.0,
    "amplifier-dead-zone": 0.2,
    "amplifier-offset": 0.05,
    "position-dependent-inductance": 0.5,
    "motional-emf": 2e-4,
    "actuation-delay": 8e-4,
    "air-gap-offset": 5e-4,
    "force-exponent": 1.8,
    "core-saturation": 1.5,
    "residual-magnetism": 0.03,
    "eddy-current-lag": 1e-3,
    "quadratic-drag": 0.05,
    "coulomb-friction": 1e-3,
    "constant-force": 2e-3,
    "periodic-disturbance": 1e-3,
    "position-sensor-offset": 1e-4,
    "position-sensor-gain": 1.05,
    "position-sensor-nonlinearity": 1.5e-4,
    "position-sensor-lag": 1e-3,
    "sensor-crosstalk": 1e-4,
    "current-sensor-offset": 0.02,
    "current-sensor-gain": 1.05,
    "sampling-delay": 8e-4,
    "lost-samples": 0.02,
}


@pytest.mark.parametrize("cause", [cause.name for cause in CATALOGUE])
def test_a_rig_with_a_cause_surprises_the_filter_that_knows_it_no_more_than_noise_does(cause: str) -> None:
    theta = strong(cause, STRENGTHS.get(cause, BY_NAME[cause].strength.probes[0]))
    records = [*narrow(theta, seconds=4.0), *made(ITEMS["multisine"], theta)]
    criterion = criterion_of(records)

    _, white = criterion.white(theta)

    flies = criterion.evidence.series.flags & FLIES != 0
    for values in (white[:, 0], white[flies, 1]):
        squares = values[np.isfinite(values)] ** 2
        # chi-square: standard error sqrt(2 / n); 1 % for what the filter linearises
        assert len(squares) > 3000
        assert abs(squares.mean() - 1.0) < 4.0 * math.sqrt(2.0 / len(squares)) + 0.01


def test_a_shaken_rig_surprises_the_filter_that_knows_it_is_shaken_no_more() -> None:
    theta = replace(THETA, process_i_c_a=4e-3, process_a_m_s2=1.0)
    criterion = criterion_of(narrow(theta, seconds=4.0))

    _, white = criterion.white(theta)
    _, unaware = criterion.white(THETA)

    series = criterion.evidence.series
    flies = series.flags & FLIES != 0
    for channel in (0, 1):
        squares = white[flies, channel] ** 2
        squares = squares[np.isfinite(squares)]
        assert abs(squares.mean() - 1.0) < 4.0 * math.sqrt(2.0 / len(squares)) + 0.01
        assert np.nanmean(unaware[flies, channel] ** 2) > 1.5


def test_a_campaign_repeated_leaves_innovations_of_the_size_of_the_noise_in_every_recording() -> None:
    theta = strong("air-gap-offset", 3e-4)
    records = [record for item in MENU if not item.warms for record in made(item, theta)]

    again = resimulate(rig_of(theta), records, seed=9)

    criterion = criterion_of(again)
    _, white = criterion.white(theta)
    series = criterion.evidence.series
    for number, record in enumerate(again):
        mine = series.recording == number
        for values in (white[mine, 0], white[mine & (series.flags & FLIES != 0), 1]):
            squares = values[np.isfinite(values)] ** 2
            if len(squares) > 300:
                assert abs(squares.mean() - 1.0) < 5.0 * math.sqrt(2.0 / len(squares)) + 0.01, record.name


def test_a_repetition_is_another_noise_on_the_same_commands() -> None:
    records = [*made(ITEMS["wide-steps"], THETA), *made(ITEMS["lift-off"], THETA)]

    once = resimulate(rig_of(THETA), records, seed=1)
    same = resimulate(rig_of(THETA), records, seed=1)
    other = resimulate(rig_of(THETA), records, seed=2)
    longer = resimulate(rig_of(THETA), [records[0], *records], seed=1)

    for a, b, c, was in zip(once, same, other, records, strict=True):
        assert np.array_equal(a.x, b.x)
        assert not np.array_equal(a.x, c.x)
        assert np.array_equal(a.t, was.t)
        assert np.array_equal(a.x_ref, was.x_ref, equal_nan=True)
    assert np.array_equal(once[1].u_c, records[1].u_c)
    assert not np.array_equal(once[0].u_c, records[0].u_c)  # the law answers its own noise
    assert np.array_equal(longer[0].x, once[0].x)


def test_what_was_not_recorded_is_not_made_up() -> None:
    (whole,) = made(ITEMS["steps"], THETA)
    keep = np.arange(len(whole.t)) % 50 != 7
    keep[500:700] = False  # 0.4 s
    partial = Record(
        name="steps", kind="closed-loop", use="judge", t=whole.t[keep], u_c=whole.u_c[keep], i_c=whole.i_c[keep],
        x=np.where(np.arange(keep.sum()) % 9 == 0, np.nan, whole.x[keep]), x_ref=whole.x_ref[keep],
    )  # fmt: skip

    (again,) = resimulate(rig_of(THETA), [partial], seed=4)

    assert np.array_equal(again.t, partial.t)
    assert np.array_equal(np.isnan(again.x), np.isnan(partial.x))
    assert np.isfinite(again.i_c).all()
    assert again.use == "judge"
    assert np.nanmax(np.abs(again.x - partial.x)) < 0.1e-3  # of steps of 0.9 mm


def test_the_emulated_board_flies_the_ball_along_the_same_path() -> None:
    from gateway.emulator.firmware_model.flash import POSITION
    from gateway.emulator.plant.constants import CE152

    rig = replace(CE152, coil_plane_above_stop_m=2.4e-3)
    lab = Lab(rig, seed=2)
    lab.fly(MIDDLE_M)
    lab.run(300)
    at, span = POSITION.to_count(MIDDLE_M), POSITION.span(0.8e-3)
    lab.excite(Shape.RECTANGLE, on_reference=True, amplitude=span, offset=at, period=500, seed=1)
    record = lab.record("steps", "closed-loop", 2000)
    theta = replace(
        THETA,
        K_A=rig.amplifier_gain_a_v, T_A=rig.amplifier_time_constant_s, K_c=rig.force_constant_n_m2_a2,
        b=rig.drag_n_s_m, sigma_x_m=rig.position_noise_m, sigma_i_c_a=rig.current_noise_a,
    )  # fmt: skip
    i_0, u_0 = rig.equilibrium_current_a(MIDDLE_M), rig.equilibrium_input_v(MIDDLE_M)
    gain = CE152.equilibrium_current_a(MIDDLE_M) / i_0 * CE152.amplifier_gain_a_v / rig.amplifier_gain_a_v
    tuned = controller()
    tuned = replace(
        tuned,
        gains=(0.49, 1700.0 / gain, 17.7 / gain, -17600.0 / gain),
        operating_point=replace(tuned.operating_point, i_c_a=i_0, u_c_v=u_0),
    )
    plant = replace(PLANT, mass_kg=rig.mass_kg, x_max_m=rig.travel_m + rig.coil_plane_above_stop_m)

    first, second = (
        resimulate(Rig(theta=theta, plant=plant, controller=tuned), [record], seed=seed)[0] for seed in (1, 2)
    )

    # Two repetitions differ by twice the variance of the loop's noise; so does either from the board's run.
    of_noise = float(np.std(first.x - second.x))
    assert np.std(record.x) > 10.0 * of_noise
    assert np.std(first.x - record.x) < 1.3 * of_noise


def test_a_coil_that_cannot_carry_the_ball_leaves_it_on_the_ground() -> None:
    hold = Schedule(name="hold", kind="closed-loop", command=np.full(500, 2e-3), closed_loop=True)

    (record,) = simulate(replace(rig_of(strong("core-saturation", 0.2)), u_max_v=5.0), hold, seed=1)

    assert np.isfinite(record.x).all()
    assert abs(float(np.median(record.x[-100:]))) < 2e-5


@pytest.mark.parametrize("cause", ["none", "eddy-current-lag", "air-gap-offset"])
def test_without_a_controller_one_is_designed_that_holds_the_ball(cause: str) -> None:
    theta = THETA if cause == "none" else strong(cause, STRENGTHS[cause])
    hold = Schedule(name="hold", kind="closed-loop", command=np.full(2000, 2e-3), closed_loop=True)

    (record,) = simulate(Rig(theta=theta, plant=PLANT), hold, seed=1)

    assert abs(float(np.mean(record.x)) - 2e-3) < 5e-6
    assert float(np.std(record.x)) < 50e-6


@pytest.mark.parametrize("lag_s", [0.0, 2e-3])
def test_the_ball_lies_where_the_stop_is_and_bounces_off_neither(lag_s: float) -> None:
    theta = replace(strong("position-sensor-lag", lag_s), stop_low_m=-1.5e-5, stop_high_m=2e-5)
    lift = lift_off_input(theta, PLANT)
    play = np.concatenate([np.full(300, 0.3 * lift), np.full(300, 1.3 * lift)])

    (record,) = simulate(Rig(theta=theta, plant=PLANT), Schedule(name="r", kind="free", command=play), seed=1)

    for part, stop in ((record.x[20:300], -1.5e-5), (record.x[-100:], PLANT.travel_m + 2e-5)):
        assert abs(float(part.mean()) - stop) < 4.0 * theta.sigma_x_m / math.sqrt(len(part))
        assert float(part.std()) == pytest.approx(theta.sigma_x_m, rel=0.4)


def test_noise_keeps_its_size_through_the_converters() -> None:
    coarse = Converters(i_lsb_a=2.5e-3, x_lsb_m=6e-6, u_lsb_v=1e-3)
    rest = Schedule(name="rest", kind="free", command=np.full(6000, 1.2))

    (record,) = simulate(Rig(theta=THETA, plant=PLANT, converters=coarse), rest, seed=1)

    # Uniform rounding noise is exact while sigma exceeds half a step; sigma of a sigma: 1 / sqrt(2 n) = 0.9 %
    sigma_i, sigma_x = sensor_noise(criterion_of([record]).evidence)
    assert sigma_i == pytest.approx(THETA.sigma_i_c_a, rel=0.04)
    assert sigma_x == pytest.approx(THETA.sigma_x_m, rel=0.04)
    converters = converters_of([replace(record, lsb=(0.0, 0.0))])
    assert converters.i_lsb_a == pytest.approx(2.5e-3, rel=1e-6)
    assert converters.x_lsb_m == pytest.approx(6e-6, rel=1e-6)


def test_a_capture_rises_to_its_level_in_its_time() -> None:
    burst = Schedule(name="burst", kind="amplifier-step", command=np.empty(0), bursts=((0.5, 1.5),))

    (record,) = simulate(Rig(theta=THETA, plant=PLANT), burst, seed=1)

    (capture,) = record.captures
    error = 4.0 * THETA.sigma_i_c_a
    assert abs(capture.i_c_a[: capture.step_index].mean() - 0.5 * THETA.K_A) < error / 10.0
    assert abs(capture.i_c_a[-300:].mean() - 1.5 * THETA.K_A) < error / 17.0
    after = capture.step_index + round(THETA.T_A / capture.sample_time_s)
    assert abs(capture.i_c_a[after] - THETA.K_A * (1.5 - math.exp(-1.0))) < error


def test_a_capture_has_the_process_noise_of_the_rig_whatever_its_sampling_interval() -> None:
    """The level refers to T_s: over half of it, a noise of the same density is smaller by the root of two."""
    schedule = Schedule(name="bursts", kind="amplifier-step", command=np.empty(0), bursts=((0.3, 1.5),))
    slow = rig_of(replace(THETA, process_i_c_a=1e-2))
    fast = replace(rig_of(replace(THETA, process_i_c_a=1e-2 / math.sqrt(2.0))), tick_s=0.5 * slow.tick_s)

    ((capture,), (other,)) = (simulate(rig, schedule, seed=3)[0].captures for rig in (slow, fast))

    assert np.allclose(other.i_c_a, capture.i_c_a, rtol=0.0, atol=1e-12)


def test_equilibria_are_repeated_from_the_force_balance() -> None:
    x = np.linspace(0.0, 5e-3, 40)
    empty = np.full(40, np.nan)
    record = Record(name="e", kind="equilibria", use="fit", t=np.arange(40.0), u_c=empty, i_c=x, x=x, x_ref=empty)

    (again,) = resimulate(Rig(theta=THETA, plant=PLANT), [record], seed=1)

    expected = np.sqrt(PLANT.mass_kg * PLANT.gravity_m_s2 / THETA.K_c) * (PLANT.x_max_m - x)
    assert np.max(np.abs(again.i_c / expected - 1.0)) < 0.003 * 4.0
    assert np.std(again.i_c / expected - 1.0) > 0.001


def test_lost_samples_are_lost() -> None:
    hold = Schedule(name="hold", kind="closed-loop", command=np.full(5000, 2e-3), closed_loop=True)

    (record,) = simulate(rig_of(strong("lost-samples", 0.1)), hold, seed=1)

    assert abs(len(record.t) - 4500) < 4.0 * math.sqrt(5000 * 0.09)
    assert TICK_S == pytest.approx(float(np.median(np.diff(record.t))))


def test_an_input_that_stood_at_its_limit_is_limited_there_in_a_repetition() -> None:
    jump = np.where(np.arange(1000) < 600, 4.6e-3, 1.2e-3)  # there it takes 2.77 V
    schedule = Schedule(name="jump", kind="closed-loop", command=jump, closed_loop=True)
    hover = Schedule(name="hover", kind="closed-loop", command=jump[:500], closed_loop=True)
    (limited,) = simulate(replace(rig_of(THETA), u_max_v=2.72), schedule, seed=1)
    (free,) = simulate(rig_of(THETA), hover, seed=1)

    (again,) = resimulate(rig_of(THETA), [limited], seed=2)

    assert input_limit(limited) == limited.u_c.max() < 2.721
    assert again.u_c.max() == pytest.approx(limited.u_c.max(), rel=1e-9)
    assert input_limit(free) == math.inf
