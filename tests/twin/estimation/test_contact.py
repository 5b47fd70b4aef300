"""Contact told by readings alone: bounces that a lagging sensor hides, noise that a converter's end cuts off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from protocol.campaign import Kind, Plant
from twin.estimation.contact import at_converter_end, bounces, held_samples, partly_cut_off
from twin.estimation.innovations import FLIES, RESTS_LOW, USE_X
from twin.estimation.record import FloatArray, Record
from twin.evidence.gather import gather
from twin.evidence.sensor_noise import sensor_noise

PLANT = Plant(name="ce152", mass_kg=8.28e-3, travel_m=5.7e-3, x_max_m=8.1e-3, gravity_m_s2=9.81)
TICK_S = 2e-3
SIGMA_M = 5e-6
COUNT_M = 1.5e-6
REST_M = 2.2 * COUNT_M  # noise at rest


def record(x: FloatArray, kind: Kind = "prbs") -> Record:
    n = len(x)
    return Record(
        name="flight",
        kind=kind,
        use="fit",
        t=np.arange(float(n)) * TICK_S,
        u_c=np.full(n, 2.0),
        i_c=np.full(n, 0.6),
        x=x,
        x_ref=np.full(n, np.nan),
    )


def thrown(speed_m_s: float, *, lag_s: float = 0.0, drag: float = 0.0, stop_m: float = 5.7e-3) -> FloatArray:
    """Heights of a ball thrown up from 1 mm, shape (50,); it leaves a stop with 0.4 of its speed.  drag: 1/m."""
    interval_s, x, v, reading, heights = 1e-5, 1e-3, speed_m_s, 1e-3, []
    for step in range(50 * round(TICK_S / interval_s)):
        if step % round(TICK_S / interval_s) == 0:
            heights.append(reading)
        v -= (9.81 + drag * v * abs(v)) * interval_s
        x += v * interval_s
        if x > stop_m and v > 0.0:
            x, v = stop_m, -0.4 * v
        reading += (x - reading) * (interval_s / lag_s if lag_s else 1.0)
    return np.array(heights)


def noisy(x: FloatArray, seed: int) -> FloatArray:
    noise = np.random.default_rng(seed).normal(0.0, SIGMA_M, len(x))
    return np.asarray(np.round((x + noise) / COUNT_M) * COUNT_M)


def bounce(height_m: float, n: int = 1000) -> FloatArray:
    """Heights of a ball at rest that is raised for 50 ms, about the middle, shape (n,)."""
    x = np.zeros(n)
    x[n // 2 : n // 2 + 25] = height_m * np.sin(np.pi * np.arange(25) / 25) ** 2
    return x


@pytest.mark.parametrize("seed", range(5))
def test_a_ball_that_bounces_does_not_lie_meanwhile(seed: int) -> None:
    raised = held_samples(record(noisy(bounce(45e-6), seed), "sawtooth"), PLANT)

    assert not raised[508:517].any(), "45 um are less than a rest may spread, and no noise"
    assert raised[:490].all()
    assert raised[535:].all()


@pytest.mark.parametrize("seed", range(5))
def test_a_rest_ends_where_it_did_whether_bounces_are_asked_for_or_not(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last current is that of lift-off: two readings fewer made another force law of it."""
    x = np.zeros(1000)
    x[800:] = 0.5 * 0.4 * (TICK_S * np.arange(200.0)) ** 2
    takes_off = record(noisy(x, seed), "sawtooth")
    with_bounces = held_samples(takes_off, PLANT)
    monkeypatch.setattr("twin.estimation.contact.BOUNCE_SCALES", np.inf)

    assert 800 < with_bounces.sum() < 830
    assert np.array_equal(with_bounces, held_samples(takes_off, PLANT))


@pytest.mark.parametrize("seed", range(5))
def test_noise_crosstalk_and_a_trembling_table_are_no_bounces(seed: int) -> None:
    i_c = 0.3 + 0.3 * np.sign(np.sin(np.arange(1000.0) / 40.0))
    trembling = 12e-6 * np.sin(2.0 * np.pi * 47.0 * TICK_S * np.arange(1000.0))

    assert held_samples(record(noisy(np.zeros(1000), seed), "sawtooth"), PLANT).all()
    assert held_samples(replace(record(noisy(60e-6 * i_c, seed), "sawtooth"), i_c=i_c), PLANT).all()
    assert held_samples(record(noisy(trembling, seed), "sawtooth"), PLANT).all()


@pytest.mark.parametrize("lag_s", [0.0, 1e-3, 2.5e-3])
def test_a_bounce_shows_whatever_the_sensor_shows_as_the_stop(lag_s: float) -> None:
    x = thrown(0.7, lag_s=lag_s)
    hit = bounces(record(noisy(x, seed=1)), PLANT)

    assert hit[np.argmax(x)]
    assert hit[: np.argmax(x) - 3].sum() == hit[np.argmax(x) + 5 :].sum() == 0
    if lag_s == 2.5e-3:
        assert x.max() < 5.3e-3  # 0.4 mm below the stop


@pytest.mark.parametrize("seed", range(5))
def test_a_ball_in_free_flight_does_not_bounce(seed: int) -> None:
    assert not bounces(record(noisy(thrown(0.25, stop_m=1.0), seed)), PLANT).any()


def test_what_slows_a_ball_without_turning_it_is_no_bounce() -> None:
    x = thrown(0.7, drag=400.0, stop_m=1.0)
    assert np.diff(x, 2).min() / TICK_S**2 < -8.0 * 9.81

    assert not bounces(record(noisy(x, seed=2)), PLANT).any()


def test_one_wrong_reading_is_no_bounce() -> None:
    x = noisy(np.full(50, 3e-3), seed=3)
    x[20] += 1e-3

    assert not bounces(record(x), PLANT).any()


def test_a_lost_reading_is_no_bounce_and_hides_none_elsewhere() -> None:
    x = thrown(0.7, lag_s=1e-3)
    top = int(np.argmax(x))
    x[top + 8] = np.nan

    hit = bounces(record(x), PLANT)

    assert hit[top]
    assert not hit[top + 4 :].any()


def test_nobody_judges_the_flight_across_a_bounce() -> None:
    """Four readings of one, 66 standard errors off, were an unknown cause."""
    high = replace(PLANT, travel_m=40e-3, x_max_m=60e-3)  # a longer flight than the CE 152 has
    x = np.concatenate([np.full(60, 0.0), thrown(1.3, lag_s=2.5e-3, stop_m=high.travel_m)])
    top = int(np.argmax(x))

    flags = gather([record(noisy(x, seed=4))], high).series.flags

    assert x[top] < 39e-3
    assert not (flags[top - 2 : top + 3] & FLIES).any()
    assert (flags[top - 10 : top - 5] & FLIES).all()
    assert (flags[top + 6 : top + 16] & FLIES).all()


def at_rest(level: float, *, seed: int, n: int = 2000) -> FloatArray:
    """Readings at rest, their noise cut off at -`level` standard deviations."""
    noise = np.random.default_rng(seed).normal(0.0, REST_M, n)
    return np.asarray(np.round(np.maximum(noise, -level * REST_M) / COUNT_M) * COUNT_M)


@pytest.mark.parametrize("seed", range(5))
def test_a_twentieth_at_the_converters_end_is_noise_cut_off(seed: int) -> None:
    x = at_rest(1.8, seed=seed)

    assert partly_cut_off(x).all()
    assert abs(x.mean() - at_rest(10.0, seed=seed).mean()) < 0.1 * REST_M  # all that the readings lose


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("n", [1000, 4000])
def test_noise_that_nothing_cuts_off_is_left_alone(seed: int, n: int) -> None:
    x = at_rest(10.0, seed=seed, n=n)

    assert not at_converter_end(x).any()
    assert not partly_cut_off(x).any()


def test_what_flies_above_the_end_is_left_alone() -> None:
    x = np.concatenate([at_rest(1.8, seed=1), noisy(thrown(0.25, stop_m=1.0)[:20], seed=1)])

    cut = partly_cut_off(x)

    assert cut[:2000].all()
    assert not cut[2000:].any()


def test_a_coarse_converter_is_not_one_at_its_end() -> None:
    x = np.round(np.random.default_rng(1).normal(0.0, 0.4, 2000)) * COUNT_M

    assert not partly_cut_off(x).any()


def test_noise_that_is_cut_off_is_not_measured() -> None:
    """Its 2.4 um where the sensor has 2.9 um were an unknown cause; where the ball lies, it is still told."""
    whole, cut = (gather([record(at_rest(level, seed=2), kind="free")], PLANT) for level in (10.0, 1.8))

    assert sensor_noise(whole)[1] == pytest.approx(REST_M, rel=0.05)
    assert sensor_noise(cut)[1] is None
    assert (cut.series.flags & (RESTS_LOW | USE_X) == RESTS_LOW | USE_X).mean() > 0.9


@pytest.mark.parametrize("hum_m", [30e-6, 100e-6])
def test_mains_in_the_reading_do_not_hide_a_ball_at_rest(hum_m: float) -> None:
    n = 2000
    mains = hum_m * np.sin(2.0 * np.pi * 50.0 * TICK_S * np.arange(n) + 0.4)
    x = np.concatenate((np.zeros(n - 200), np.linspace(0.0, 5e-3, 200)))

    held = held_samples(record(noisy(x + mains, 1), "sawtooth"), PLANT)

    assert held[: n - 200].all()
    assert not held[n - 180 :].any()
