"""The law in integers: what it costs, how it saturates, and that it holds the ball."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.emulator.firmware_model.arithmetic import saturate, scaled_product, sine_q15
from gateway.emulator.firmware_model.flash import (
    CURRENT,
    GAINS,
    INPUT,
    K_LQI,
    K_PID,
    OPERATING_POINT,
    POSITION,
    T_S_US,
    ConverterScale,
    gains_in_counts,
)
from gateway.emulator.firmware_model.law import ControlLaw
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.messages import COUNTS_MAX, Law
from tests.harness.gateway.board_host import Host

PID_GAINS = gains_in_counts(Law.PID, K_PID, OPERATING_POINT)
ROUNDING_RMS = 12**-0.5  # of a count, uniformly distributed
TERMS = 4


def float_law(i: int, x: int, x_previous: int, total: int) -> float:
    """Eq. (16)-(19) in floating point and SI, with the gains as designed; u in counts."""
    t_s = T_S_US * 1e-6
    k_i, k_x, k_v, k_int = K_LQI
    u_v = INPUT.to_si(GAINS.u_0) - (
        k_i * (CURRENT.to_si(i) - CURRENT.to_si(GAINS.i_0))
        + k_x * (POSITION.to_si(x) - POSITION.to_si(GAINS.x_0))
        + k_v * (x - x_previous) * POSITION.lsb / t_s
        + k_int * total * POSITION.lsb * t_s
    )
    return (u_v - INPUT.offset) / INPUT.lsb


def test_fixed_point_costs_a_fraction_of_what_the_converter_costs(capsys: pytest.CaptureFixture[str]) -> None:
    chance = random.Random(20240611)
    before_rounding: list[float] = []
    after: list[float] = []

    while len(after) < 20_000:
        law = ControlLaw(GAINS)
        i, x = chance.randrange(3300), chance.randrange(38, 4031)
        x_previous = x + chance.randrange(-700, 701)  # 0.5 m/s: as fast as the ball gets within its travel
        law.run(i, x_previous, x_previous)
        law.sum = chance.randrange(-120_000, 120_000)  # 120 000: k_int times it is the whole input range
        expected = float_law(i, x, x_previous, law.sum)
        before_rounding.append(law.accumulate(i, x, x) / 256 - expected)
        u, limited = law.run(i, x, x)
        if not limited:
            after.append(u - expected)

    rms = (sum(e * e for e in after) / len(after)) ** 0.5
    raw_rms = (sum(e * e for e in before_rounding) / len(before_rounding)) ** 0.5
    with capsys.disabled():
        print(
            f"\nfixed point against float: before rounding max {max(map(abs, before_rounding)):.3f} rms {raw_rms:.4f}, "
            f"with rounding max {max(map(abs, after)):.3f} rms {rms:.4f} counts (1 count = {INPUT.lsb * 1e3:.2f} mV)"
        )
    # Four truncations of 1/256, and each gain right to half a unit of its mantissa, over the largest deviations above.
    deviations = (2000, 2034, 700, 120_000)
    gains = sum(d * 0.5 * 2.0**-s for d, s in zip(deviations, GAINS.shifts, strict=True))
    assert max(map(abs, before_rounding)) <= TERMS / 256 + gains
    assert max(map(abs, after)) <= 0.5 + TERMS / 256 + gains
    assert rms < 1.05 * ROUNDING_RMS


@given(mantissa=st.integers(-32767, 32767), shift=st.integers(0, 30), operand=st.integers(-(1 << 23), (1 << 23) - 1))
def test_a_product_is_truncated_or_saturated_and_never_wraps(mantissa: int, shift: int, operand: int) -> None:
    exact = mantissa * operand * 2.0 ** (8 - shift)

    product = scaled_product(mantissa, shift, operand)

    if -(2.0**31) <= exact < 2.0**31:
        assert 0.0 <= exact - product < 1.0
    else:
        assert product == (-(1 << 31) if exact < 0 else (1 << 31) - 1)


def test_the_sine_table_is_right_to_a_ten_thousandth() -> None:
    phases = range(0, 1 << 32, (1 << 32) // 5003)

    worst = max(abs(sine_q15(phase) / 32767 - math.sin(math.tau * phase / 2**32)) for phase in phases)

    assert worst < 1.5e-4


def test_u_comes_from_the_sum_before_this_error_is_added() -> None:
    law = ControlLaw(GAINS)

    first, _ = law.run(GAINS.i_0, GAINS.x_0, GAINS.x_0 + 500)
    second, _ = law.run(GAINS.i_0, GAINS.x_0, GAINS.x_0 + 500)

    assert first == GAINS.u_0
    assert law.sum == 1000
    assert second == round(GAINS.u_0 - GAINS.mantissas[3] * 2.0 ** -GAINS.shifts[3] * 500)


@pytest.mark.parametrize("gains", [GAINS, PID_GAINS], ids=["lqi", "pid"])
@pytest.mark.parametrize("side", [1, -1], ids=["up", "down"])
def test_the_integral_stops_where_u_is_limited_and_only_in_that_direction(gains: object, side: int) -> None:
    law = ControlLaw(gains)  # type: ignore[arg-type]  # pytest's parameters are objects
    x, x_ref = (38, 3680) if side > 0 else (4030, 248)

    for _ in range(300):
        u, limited = law.run(GAINS.i_0, x, x_ref)
    stuck = law.sum
    law.run(GAINS.i_0, x, x_ref)
    unchanged = law.sum
    law.run(GAINS.i_0, x, x - side * 100)

    assert limited
    assert u == (COUNTS_MAX if side > 0 else 0)
    assert unchanged == stuck
    assert law.sum == stuck - side * 100


def test_the_integral_saturates_at_24_bits() -> None:
    law = ControlLaw(gains_in_counts(Law.LQI, (0.0, 0.0, 0.0, 0.0), OPERATING_POINT))

    for _ in range(2500):
        law.run(0, 0, COUNTS_MAX)

    assert law.sum == saturate(2500 * COUNTS_MAX, 24) == (1 << 23) - 1


REFERENCES_M = (2.85e-3, 1.0e-3, 3.0e-3, 4.5e-3, 2.5e-3, 1.0e-3)


@pytest.mark.usefixtures("each_firmware")
@pytest.mark.parametrize("law", [Law.LQI, Law.PID], ids=["lqi", "pid"])
def test_the_ball_is_lifted_from_the_bottom_stop_and_follows_references(law: Law) -> None:
    plant = EmulatedPlant(seed=7)
    host = Host(plant)
    if law is Law.PID:
        gains = PID_GAINS
        numbers = {f"k{n}_mantissa": m for n, m in enumerate(gains.mantissas, 1)}
        numbers |= {f"k{n}_shift": s for n, s in enumerate(gains.shifts, 1)}
        answer = host.request("SET_GAINS", law=1, **numbers, i_0=gains.i_0, x_0=gains.x_0, u_0=gains.u_0)
        assert answer.name == "ACK"
    assert plant.x_m == 0.0

    host.request("SET_MODE", mode=2)
    settling_s = []
    for reference_m in REFERENCES_M:
        assert host.request("SET_REFERENCE", x_ref=POSITION.to_count(reference_m)).name == "ACK"
        track = []
        for _ in range(500):
            host.run(1)
            track.append(plant.x_m)
            if len(host.states) % 100 == 0:
                host.request("GET_PARAMETERS")
        outside = [n for n, x in enumerate(track) if abs(x - reference_m) > 50e-6]
        settling_s.append((outside[-1] + 1) * T_S_US * 1e-6 if outside else 0.0)
        mean = sum(track[-100:]) / 100
        # 5 um sensor noise through the loop; the mean of 100 samples is within a count and the noise's own mean.
        assert abs(mean - reference_m) < 5e-6
        assert max(abs(x - mean) for x in track[-100:]) < 30e-6

    assert max(settling_s) < 0.4, settling_s  # five time constants of the integral at 14 rad/s, from a jump of 2 mm


def test_the_speed_is_zero_at_the_first_tick_of_closed_loop() -> None:
    law = ControlLaw(GAINS)
    law.run(GAINS.i_0, 1000, GAINS.x_0)

    law.reset()
    u, _ = law.run(GAINS.i_0, GAINS.x_0, GAINS.x_0)

    assert u == GAINS.u_0


def test_flash_holds_the_measured_rig_at_its_operating_point() -> None:
    plant = EmulatedPlant()
    i_0_a, x_0_m, u_0_v = OPERATING_POINT

    # Three digits are given: half a unit of the last one.
    assert plant.rig.equilibrium_current_a(x_0_m) == pytest.approx(i_0_a, abs=5e-4)
    assert plant.rig.equilibrium_input_v(x_0_m) == pytest.approx(u_0_v, abs=2e-3)


@pytest.mark.parametrize("scaling", [CURRENT, POSITION, INPUT], ids=["i_c", "x", "u_c"])
def test_every_count_comes_back_from_its_si_value(scaling: ConverterScale) -> None:
    assert all(scaling.to_count(scaling.to_si(n)) == n for n in range(4096))
    assert [scaling.to_count(value) for value in (-1e9, 1e9, math.nan)] == [0, 4095, 0]
