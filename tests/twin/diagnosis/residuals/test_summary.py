from __future__ import annotations

import json
import math
from functools import cache

import numpy as np
import pytest

from tests.harness.diagnose.known_diagnosis import QUIET, diagnosis, steps
from tests.harness.diagnose.simulated_rig import PLANT, TICK_S, controller, strong
from twin.diagnosis.residuals.force import filtered, parabola
from twin.diagnosis.residuals.regimes import bin_labels, blocks_of, error_bins
from twin.diagnosis.residuals.spectrum import spectrum
from twin.diagnosis.residuals.step_response import Steps, step_responses
from twin.diagnosis.residuals.summary import Summary, summarise, to_dict
from twin.estimation.family import holm
from twin.evidence.gather import gather
from twin.inference.noise_floor import Floor

pytestmark = pytest.mark.xdist_group("diagnosis-summary")  # what several tests look at is made once
GAP_M = 5e-4
FLOOR = Floor(sigma_i_c_a=QUIET.sigma_i_c_a, sigma_x_m=QUIET.sigma_x_m, measured=True, counts=(0, 1))


@cache
def with_gap() -> Summary:
    return summarise(diagnosis("air-gap-offset", GAP_M), controller())


@cache
def with_drag() -> Summary:
    return summarise(diagnosis("quadratic-drag", 2.0), controller())


def curve(show: Summary, name: str) -> dict[float, tuple[float, float]]:
    """Return the forces of baseline and extended model by place, N."""
    profile = next(entry for entry in show.force if entry.name == name)
    return {point.at: (point.baseline.value, point.extended.value) for point in profile.points}


def spread(show: Summary, name: str) -> dict[float, float]:
    """Standard error of the baseline's by place, N, from its 95 % interval."""
    profile = next(entry for entry in show.force if entry.name == name)
    return {point.at: (point.baseline.high - point.baseline.low) / (2.0 * 1.96) for point in profile.points}


def test_the_extended_model_is_at_the_noise_floor_and_the_baseline_far_above() -> None:
    at_20 = next(entry for entry in with_gap().ahead if abs(entry.horizon_s - 0.02) < 1e-3)

    assert at_20.baseline.low > 3.0 * at_20.floor_m
    assert at_20.extended.value == pytest.approx(at_20.floor_m, rel=0.15)
    assert at_20.baseline.low < at_20.baseline.value < at_20.baseline.high


def test_the_missing_force_of_a_gap_offset_is_the_difference_of_the_two_laws() -> None:
    points = curve(with_gap(), "x")

    assert len(points) >= 2
    for x, (before, after) in points.items():
        gap = PLANT.x_max_m - x
        # The ball stands most of the time: there K_c i^2 / (gap + d)^2 = m g on the rig, and the baseline has gap^2.
        expected = PLANT.mass_kg * PLANT.gravity_m_s2 * (1.0 - ((gap + GAP_M) / gap) ** 2)
        assert before == pytest.approx(expected, rel=0.03)
        assert abs(after) < 0.01 * abs(expected)


def test_the_missing_force_of_quadratic_drag_follows_the_square_of_the_speed() -> None:
    points, error = curve(with_drag(), "v"), spread(with_drag(), "v")
    fast = [(v, before) for v, (before, _) in points.items() if abs(v) > 0.01]

    assert any(v < 0.0 for v, _ in fast)
    assert any(v > 0.0 for v, _ in fast)
    for v, before in fast:
        # A group's mean of v |v| lies above the square of its mean speed, at most twice for a group down from 0.
        drag, margin = -before * math.copysign(1.0, v), 4.0 * error[v]
        assert 2.0 * v * v - margin < drag < 4.0 * v * v + margin
        assert drag > 2.0 * margin, "more than noise"
    assert max(abs(after) for _, after in points.values()) < 2e-4  # near standstill, where the loop answers noise


def test_a_right_model_leaves_no_force_however_fast_the_ball_moves() -> None:
    record = steps(QUIET, seed=5, seconds=8.0)
    evidence = gather([record], PLANT)

    force = filtered(evidence, QUIET, PLANT, TICK_S).force_n

    known = force[np.isfinite(force)]
    _, weights = parabola(round(0.5 * 0.03 / TICK_S), TICK_S)
    # Independent windows: one in fifteen samples.
    noise_n = PLANT.mass_kg * QUIET.sigma_x_m * float(np.linalg.norm(weights))
    assert len(known) > 3000
    assert abs(float(known.mean())) < 4.0 * noise_n / math.sqrt(len(known) / len(weights))


def test_a_late_amplifier_leaves_no_force() -> None:
    delayed = strong("actuation-delay", 8e-4, QUIET)
    evidence = gather([steps(delayed, seed=6, seconds=8.0)], PLANT)

    force = filtered(evidence, QUIET, PLANT, TICK_S).force_n

    assert float(np.sqrt(np.nanmean(force) ** 2)) < 1e-4  # N; the weight is 81 mN


def test_the_rig_with_a_slow_sensor_is_late_and_the_extended_simulation_as_late() -> None:
    rig = strong("position-sensor-lag", 3e-3, QUIET)
    record = steps(rig, seed=2, use="judge")

    result = step_responses([record], QUIET, rig, FLOOR, PLANT, controller(), TICK_S)

    assert isinstance(result, Steps)
    before, after = (float(np.sqrt(np.mean((result.rig - model) ** 2))) for model in (result.baseline, result.extended))
    # What is left is noise of rig and simulation over the steps, in shares of a step of 1.8 mm.
    assert after < 4.0 * QUIET.sigma_x_m * math.sqrt(2.0 / result.count) / 1.8e-3
    assert before > 3.0 * after


def test_a_campaign_without_a_controller_says_why_there_are_no_steps() -> None:
    record = steps(QUIET, seed=2, seconds=2.0)

    result = step_responses([record], QUIET, QUIET, FLOOR, PLANT, None, TICK_S)

    assert isinstance(result, str)
    assert "[controller]" in result


def test_errors_by_position_grow_with_the_distance_from_where_the_laws_agree() -> None:
    position = next(entry for entry in with_gap().regimes if entry.name == "position")

    assert len(position.bins) >= 2
    assert not with_gap().worse()
    assert all(entry.baseline.low > entry.extended.high for entry in position.bins)


def test_without_judge_recordings_the_errors_are_said_to_be_of_the_fit() -> None:
    show = summarise(diagnosis("air-gap-offset", GAP_M, has_judges=False), controller(), quick=True)

    assert not show.from_judges
    assert show.ahead
    assert isinstance(show.steps, str)


def test_a_model_that_is_worse_is_said_to_be_worse() -> None:
    rng = np.random.default_rng(1)
    recording = np.zeros(5000, np.int32)
    noise = rng.standard_normal((2, 5000)) * 1e-6
    noise[1, :2500] *= 1.5
    labels = bin_labels(np.arange(5000.0), np.array([0.0, 2500.0, 5000.0]))

    bins = error_bins(noise, labels, ["early", "late"], np.arange(5000.0), blocks_of(recording, TICK_S, 0))

    assert holm([error_bin.chance for error_bin in bins]) == [True, False]


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(2)
    recording, labels = np.zeros(10_000, np.int32), np.zeros(10_000, np.int64)
    blocks = blocks_of(recording, TICK_S, 0)
    covered = 0
    for _ in range(200):
        errors = np.tile(rng.standard_normal(10_000), (2, 1))
        (error_bin,) = error_bins(errors, labels, ["all"], labels.astype(float), blocks)
        covered += error_bin.baseline.low <= 1.0 <= error_bin.baseline.high
    # 40 blocks: the percentile interval of a root mean square covers some 93 %; 200 trials: sd 1.8 %.
    assert covered / 200 > 0.93 - 3 * 0.018


def test_white_noise_has_a_flat_spectrum_at_its_floor_and_a_line_stands_out() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(20_000) * TICK_S
    white = rng.standard_normal(20_000) * 2e-6
    errors = np.array([white + 3e-6 * np.sin(2 * np.pi * 40.0 * t), white])

    result = spectrum(errors, 2e-6, TICK_S)

    assert result is not None
    assert np.median(result.extended) == pytest.approx(result.floor, rel=0.05)
    assert result.frequency_hz[int(np.argmax(result.baseline))] == pytest.approx(40.0)


def test_the_numbers_are_json_and_the_same_every_time() -> None:
    result = diagnosis("air-gap-offset", GAP_M, seconds=6.0)

    texts = [json.dumps(to_dict(summarise(result, controller())), allow_nan=False) for _ in range(2)]

    assert texts[0] == texts[1]
    assert {"ahead", "regimes", "force", "current", "spectrum", "steps", "judged"} <= json.loads(texts[0]).keys()
