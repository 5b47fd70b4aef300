"""The truth comes back: from a plant of the tests' own, from the emulated board, from damaged recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import INPUT
from protocol.wire.messages import Mode, Shape
from tests.harness.twin.emulated_campaign import TRUTHS, Lab, campaign_of, random_rig, run_campaign, truth
from tests.harness.twin.independent_plant import Ball, wandering
from twin.estimation.prepare import BLOCK_SAMPLES, prepare
from twin.estimation.record import Record
from twin.identification.pipeline import identify_records
from twin.identification.result import Identification

TICKS = 4000
BALL = Ball()


@pytest.fixture(scope="module")
def flight() -> Record:
    return BALL.closed_loop(wandering(1, TICKS), TICKS, seed=2)


@pytest.fixture(scope="module")
def steps() -> Record:
    levels = (0.0, 0.8, 1.6, 0.4, 1.2)
    return BALL.driven(lambda k: levels[k // 100 % 5], 1000, seed=3, kind="amplifier-step", name="steps")


def check(result: Identification, true: dict[str, float], names: tuple[str, ...] = TRUTHS, z: float = 4.0) -> None:
    """Every estimate within `z` of its own standard errors."""
    for name in names:
        parameter = result.model.parameters[name]
        assert parameter.std is not None, name
        assert abs(parameter.value - true[name]) < z * parameter.std, (name, parameter, true[name])


def truth_of(ball: Ball) -> dict[str, float]:
    return {"K_A": ball.K_A, "T_A": ball.T_A, "K_c": ball.K_c, "b": ball.b}


def test_a_plant_of_the_tests_own_comes_back(flight: Record, steps: Record) -> None:
    result = identify_records(BALL.campaign, [steps, flight])

    check(result, truth_of(BALL))
    assert result.usable
    assert result.whiteness is not None
    assert result.whiteness.white
    assert {n: p.verdict for n, p in result.model.parameters.items()} == dict.fromkeys(TRUTHS, "identified")
    assert result.model.noise.sigma_x_m == pytest.approx(BALL.sigma_x, rel=0.05)
    assert result.model.noise.sigma_i_c_a == pytest.approx(BALL.sigma_i, rel=0.05)


def test_an_emulated_campaign_comes_back() -> None:
    rig = random_rig(np.random.default_rng(20))

    result = identify_records(campaign_of(rig), run_campaign(rig, seed=20))

    check(result, truth(rig))
    assert result.usable
    assert result.shape is not None
    assert result.shape.first_order


def test_a_ball_that_bounces_between_the_stops_needs_no_cutting() -> None:
    rig = random_rig(np.random.default_rng(5))
    lab = Lab(rig, seed=5)
    lab.request("SET_MODE", mode=int(Mode.OPEN_LOOP))
    lift = INPUT.to_count(rig.equilibrium_input_v(0.2e-3))
    lab.excite(
        Shape.PRBS, on_reference=False, amplitude=round(0.55 * lift), offset=round(0.65 * lift), period=15, seed=9
    )
    record = lab.record("bounces", "prbs", 8000)

    result = identify_records(campaign_of(rig), [record])

    (usage,) = result.usages
    assert usage.flights > 50
    assert usage.contact_samples > 1000
    check(result, truth(rig), ("K_A", "K_c", "b"), z=5.0)


def test_damage_is_reported_and_does_no_harm(flight: Record) -> None:
    rng = np.random.default_rng(8)
    x, i, u = flight.x.copy(), flight.i_c.copy(), flight.u_c.copy()
    x[rng.choice(np.arange(100, TICKS, 7), 20, replace=False)] += 1e-3  # bit errors
    i[rng.choice(TICKS, 10, replace=False)] = np.nan
    u[2000] = np.nan
    keep = np.ones(TICKS, np.bool_)
    keep[rng.choice(TICKS, 30, replace=False)] = False  # lost frames
    damaged = replace(
        flight, t=flight.t[keep], x=x[keep], i_c=i[keep], u_c=u[keep], x_ref=flight.x_ref[keep], name="damaged"
    )

    result = identify_records(BALL.campaign, [damaged])

    (usage,) = result.usages
    assert usage.gaps >= 25
    assert 15 <= usage.outliers <= 25
    assert any("outlying readings" in warning for warning in result.warnings)
    assert any("gaps" in warning for warning in result.warnings)
    check(result, truth_of(BALL))


def test_a_sampling_time_that_varies_by_a_third_is_no_obstacle() -> None:
    record = BALL.closed_loop(wandering(4, TICKS), TICKS, seed=5, jitter=0.33)

    check(identify_records(BALL.campaign, [record]), truth_of(BALL))


def test_no_drag_is_said_to_be_none() -> None:
    ball = Ball(b=0.0)

    result = identify_records(ball.campaign, [ball.closed_loop(wandering(6, TICKS), TICKS, seed=7)])

    b = result.model.parameters["b"]
    assert b.ci95 is not None
    assert b.ci95[0] < 2e-3
    assert b.verdict != "identified"
    assert any(warning.startswith("b is") for warning in result.warnings)


def test_an_input_logged_one_sample_early_is_recognised(flight: Record) -> None:
    early = replace(flight, u_c=np.append(flight.u_c[1:], flight.u_c[-1]))

    result = identify_records(BALL.campaign, [early])

    assert result.usages[0].input_delay == 1
    assert any("later than recorded" in warning for warning in result.warnings)
    check(result, truth_of(BALL))


def test_lift_off_alone_gives_the_force_constant_by_equation_8() -> None:
    top = 1.1 * BALL.current(0.0) / BALL.K_A
    ramp = BALL.driven(lambda k: top * (k % 1500) / 1500, 4500, seed=11, kind="sawtooth", name="sawtooth")

    result = identify_records(BALL.campaign, [ramp])

    K_c, b = result.model.parameters["K_c"], result.model.parameters["b"]
    assert K_c.equation == "(8)"
    assert K_c.value == pytest.approx(BALL.K_c, rel=0.01)
    assert K_c.ci95 is not None
    assert K_c.ci95[0] < BALL.K_c < K_c.ci95[1]
    assert b.verdict == "not-identifiable"


def test_a_response_that_is_not_first_order_is_said_and_k_a_stays_right() -> None:
    rig = random_rig(np.random.default_rng(12))
    records = run_campaign(rig, seed=12, flight_s=4.0, effects={"slew-rate-limit": 100.0})

    result = identify_records(campaign_of(rig), records[:1])

    assert result.shape is not None
    assert not result.shape.first_order
    assert any("not first order" in warning for warning in result.warnings)
    K_A = result.model.parameters["K_A"]
    assert "steady levels" in K_A.method
    assert K_A.value == pytest.approx(rig.amplifier_gain_a_v, rel=2e-3)


@pytest.mark.slow
def test_what_the_model_lacks_is_said_and_drag_is_not_called_identified() -> None:
    rig = random_rig(np.random.default_rng(14))
    records = run_campaign(rig, seed=14, flight_s=8.0, effects={"motional-emf": 0.5})

    result = identify_records(campaign_of(rig), records)

    assert result.whiteness is not None
    assert not result.whiteness.white
    assert any("not white" in warning for warning in result.warnings)
    assert result.model.parameters["b"].verdict != "identified"


def test_levels_off_a_line_widen_the_gain_and_are_said() -> None:
    rig = random_rig(np.random.default_rng(44))
    limited = run_campaign(rig, seed=44, flight_s=4.0, effects={"current-limit": 0.65})[:1]

    result = identify_records(campaign_of(rig), limited)

    K_A = result.model.parameters["K_A"]
    assert any("do not lie on a line" in warning for warning in result.warnings)
    assert K_A.verdict != "identified"
    assert K_A.ci95 is not None
    assert K_A.ci95[0] < rig.amplifier_gain_a_v < K_A.ci95[1]


@pytest.mark.slow
def test_an_amplifier_too_fast_to_be_seen_is_no_obstacle() -> None:
    rig = replace(random_rig(np.random.default_rng(7)), amplifier_time_constant_s=2e-5)

    result = identify_records(campaign_of(rig), run_campaign(rig, seed=7, flight_s=8.0)[2:])

    T_A = result.model.parameters["T_A"]
    assert result.usable
    assert T_A.verdict == "not-identifiable"
    assert T_A.ci95 is not None
    assert T_A.ci95[0] <= 2e-5 <= T_A.ci95[1] < 2e-4  # a tenth of the sampling interval is seen
    assert abs(result.model.K_c / rig.force_constant_n_m2_a2 - 1.0) < 1e-3


def test_gaps_are_counted_wherever_the_series_is_cut_into_blocks() -> None:
    n = 2 * BLOCK_SAMPLES + 100
    t = 2e-3 * np.arange(n, dtype=np.float64)
    t[BLOCK_SAMPLES:] += 1.0
    t[BLOCK_SAMPLES + 50 :] += 1.0
    zeros = np.zeros(n)
    record = Record(name="r", kind="free", use="fit", t=t, u_c=zeros + 1.0, i_c=zeros, x=zeros, x_ref=zeros)

    _, (usage,) = prepare([record], campaign_of(random_rig(np.random.default_rng(1))).plant)

    assert usage.gaps == 2
