"""The filter compiled against the same in plain Python, and what it says of samples that are not all there."""

from __future__ import annotations

import numpy as np
import pytest

from twin.compiled import Packed
from twin.estimation.ekf import filter as ekf
from twin.estimation.ekf.memory import memory_for
from twin.estimation.innovations import CAPTURED, FLIES, FOLLOWS, RESTS_HIGH, USE_I, USE_X
from twin.estimation.record import FloatArray
from twin.estimation.structures import AT_THE_ENDS, NO_STEPS, NoiseLevels, Results, Samples, System, room_for
from twin.model.causes import (
    actuation_delay,
    current_sensor_lag,
    eddy_current_lag,
    position_dependent_inductance,
    position_sensor_gain,
)
from twin.model.causes.catalogue import neutral
from twin.model.extended import I_C, V, X

BASE: Packed = (0.3, 3e-4, 8e-6, 0.03, 0.0118, 9.81, 8.1e-3, 5.7e-3)
NOISE = NoiseLevels(2e-3, 5e-6, 1e-4, 0.02, 2e-3)
PAPER = System(BASE, neutral(), NOISE, AT_THE_ENDS, closed_form=True)


def readings(n: int) -> Samples:
    """A ball that hovers, seen through noise: without x at 10, without i_c at 20, at a stop from 30 to 33."""
    rng = np.random.default_rng(1)
    flags = np.full(n, FOLLOWS | FLIES | USE_I | USE_X, np.uint16)
    flags[0] &= ~FOLLOWS & 0xFFFF
    flags[10] &= ~USE_X & 0xFFFF
    flags[20] &= ~USE_I & 0xFFFF
    flags[30:34] &= ~FLIES & 0xFFFF
    return Samples(
        np.linspace(0.0, 2e-3 * (n - 1), n),
        np.full(n, 2e-3),
        2.1 + 0.01 * rng.normal(size=n),
        0.63 + 2e-3 * rng.normal(size=n),
        2.9e-3 + 5e-6 * rng.normal(size=n),
        flags,
    )


def plain(system: System, samples: Samples) -> Results:
    """`filtered` with its own loop in plain Python."""
    results = room_for(len(samples.u), 3, state=True)
    getattr(ekf._run, "py_func", ekf._run)(memory_for(system), samples, NO_STEPS, results)
    return results


def test_compiled_and_plain_filter_agree() -> None:
    samples = readings(60)

    compiled, interpreted = ekf.filtered(PAPER, samples, state=True), plain(PAPER, samples)

    np.testing.assert_allclose(compiled.innovations, interpreted.innovations, rtol=1e-9, atol=1e-15)
    assert np.isnan(compiled.innovations[10, 1])
    assert np.isnan(compiled.innovations[20, 0])
    assert np.isfinite(compiled.innovations[1, 0])  # in closed form u_c is known from the first sample on


def test_the_closed_form_is_the_step_of_the_model_without_causes() -> None:
    """Beside the first two readings of i_c, which say nothing where the input may be late, up to its 60 nm."""
    samples = readings(60)

    closed, stepped = (ekf.filtered(PAPER._replace(closed_form=form), samples, state=True) for form in (True, False))

    assert np.isnan(stepped.innovations[1:3, 0]).all()
    np.testing.assert_allclose(closed.state[3:, I_C], stepped.state[3:, I_C], atol=1e-3)
    np.testing.assert_allclose(closed.state[8:, X], stepped.state[8:, X], atol=1e-7)
    np.testing.assert_allclose(closed.state[8:, V], stepped.state[8:, V], atol=1e-4)


@pytest.mark.parametrize("tau_s", [2e-4, 2e-3])
def test_a_lagging_field_begins_as_uncertain_as_a_current_behind_a_slow_sensor(tau_s: float) -> None:
    """Were it known, each start would favour eddy currents."""

    def variance(index: int, row: int) -> float:
        c = neutral()
        c[index] = tau_s
        spread = ekf.filtered(System(BASE, c, NOISE, AT_THE_ENDS), readings(40), spread=True).spread
        return float(spread[0, row, row])

    field, current = variance(eddy_current_lag.TAU, 3), variance(current_sensor_lag.TAU, 0)

    assert field == pytest.approx(current, rel=0.1)


def test_a_capture_shows_its_share_of_a_delay_and_the_loop_all_of_it() -> None:
    """As where the loop's output is late: a capture counts its time from its own step."""
    samples = steps_of_u(CAPTURED, 0)

    delayed = innovations(samples, delay_s=4e-4, share=0.25)

    half = len(samples.u) // 2
    np.testing.assert_array_equal(delayed[:half], innovations(samples, delay_s=1e-4)[:half])
    np.testing.assert_array_equal(delayed[half:], innovations(samples, delay_s=4e-4)[half:])
    assert not np.allclose(delayed[:half], innovations(samples, delay_s=4e-4)[:half], equal_nan=True)


def test_a_capture_shows_its_share_of_a_jitter_and_the_loop_all_of_it() -> None:
    """From the interval in which the step of u_c comes into force, a small jitter adds what the slope there says."""
    samples = steps_of_u(CAPTURED, 0)
    half, delay_s, jitter_s = len(samples.u) // 2, 6e-5, 1e-6

    usual = innovations(samples, delay_s=delay_s, share=0.5)
    drawn = innovations(samples, delay_s=delay_s, share=0.5, jitter_s=jitter_s)

    added = drawn[:, 2] - usual[:, 2]
    for begin, share, first in ((0, 0.5, 51), (half, 1.0, 52)):
        rows = begin + np.arange(51, 60)
        slope_a_s = BASE[0] / BASE[1] * np.exp(-((first - 50) * 40e-6 - share * delay_s) / BASE[1])
        assert added[begin + 2 : begin + first] == pytest.approx(0.0, abs=1e-15)
        assert added[begin + first] == pytest.approx((slope_a_s * share * jitter_s) ** 2, rel=1e-3)
        assert np.all(added[rows[rows > begin + first]] < added[begin + first])


def test_the_current_of_a_ball_at_a_stop_does_not_depend_on_what_the_sensor_reads_there() -> None:
    """The inductance is that of the stop, where the ball is."""
    n, travel_m = 40, BASE[-1]
    flags = np.full(n, FOLLOWS | USE_I | USE_X | RESTS_HIGH, np.uint16)
    flags[0] &= ~FOLLOWS & 0xFFFF
    u = np.where(np.arange(n) < 20, 1.0, 2.0)

    def rests(gain: float, reading_m: float) -> FloatArray:
        c = neutral()
        c[position_dependent_inductance.GROWTH], c[position_sensor_gain.GAIN] = 0.5, gain
        samples = Samples(
            np.linspace(0.0, 2e-3 * (n - 1), n), np.full(n, 2e-3), u, 0.3 * u, np.full(n, reading_m), flags
        )
        return ekf.filtered(System(BASE, c, NOISE, AT_THE_ENDS), samples).innovations

    np.testing.assert_allclose(rests(0.9, 0.9 * travel_m), rests(1.0, travel_m), atol=1e-15)
    assert np.nanmax(np.abs(rests(1.0, travel_m)[:, 0])) > 0.1  # the step of u_c shows


def steps_of_u(*kinds: int) -> Samples:
    """A step of u_c every 40 us with the ball at rest, once as each kind: CAPTURED or 0."""
    n = 200
    flags = np.concatenate([np.full(n, FOLLOWS | USE_I | kind, np.uint16) for kind in kinds])
    flags[::n] &= ~FOLLOWS & 0xFFFF
    u = np.tile(np.where(np.arange(n) < 50, 1.0, 2.0), len(kinds))
    step = np.full(len(u), 40e-6)
    return Samples(np.cumsum(step), step, u, 0.3 * u, np.zeros(len(u)), flags)


def innovations(samples: Samples, *, delay_s: float, share: float = 1.0, jitter_s: float = 0.0) -> FloatArray:
    c = neutral()
    c[actuation_delay.JITTER] = jitter_s
    c[actuation_delay.DELAY], c[actuation_delay.IN_CAPTURES] = delay_s, share
    return ekf.filtered(PAPER._replace(c=c, closed_form=False), samples).innovations
