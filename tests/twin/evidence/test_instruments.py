"""Noise as instruments have it: by recording, over the height, with outliers; told before any model."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import draw_rig, make_campaign
from tests.harness.diagnose.instruments import Instrument, worse
from tests.harness.diagnose.simulated_rig import PLANT, THETA, criterion_of, narrow
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.result import Diagnosis, to_json
from twin.estimation.ekf.filter import filtered
from twin.estimation.innovations import USE_I, USE_X
from twin.estimation.prediction_floor import floor_rmse
from twin.evidence.gather import Evidence, gather
from twin.evidence.instruments import instruments, with_noise
from twin.evidence.noise_levels import Channel, Level, Noise
from twin.evidence.outliers import without_outliers
from twin.evidence.sensor_noise import noise_errors, sensor_noise
from twin.readers.campaign import read_campaign

SEED, EFFECTS = 9011, {"air-gap-offset": 3e-4}
RIG = draw_rig(SEED, "emulator")
I_A, X_M = RIG.current_noise_a, RIG.position_noise_m
SCOPE = 8.0 / 3.0  # 4 mA beside 1.5 mA
SLOPE = 2.0 * X_M / RIG.travel_m
NO_LESS = 0.0  # A: where the converter of this board ends


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("instruments") / "campaign"
    make_campaign(folder, effects=EFFECTS, seed=SEED, plant="emulator", quick=True)
    return folder


def copy_of(campaign: Path, folder: Path) -> Path:
    return Path(shutil.copytree(campaign, folder / "copy"))


def evidence_of(folder: Path, use: str = "fit") -> Evidence:
    campaign = load(folder)
    return gather(read_campaign(campaign, use=use), campaign.plant)


def level_of(channel: Channel, source: str, *, flies: bool = False) -> Level:
    return next(level for level in channel.levels if source in level.sources and level.flies == flies)


def answer(folder: Path) -> Diagnosis:
    return diagnose(load(folder), Options(quick=True, workers=1))


def assert_diagnosed(diagnosis: Diagnosis) -> None:
    assert diagnosis.verdict == "causes-found", diagnosis.sentence
    assert [cause.name for cause in diagnosis.causes] == list(EFFECTS)
    value = diagnosis.causes[0].parameters["d_m"].value
    assert value == pytest.approx(EFFECTS["air-gap-offset"], rel=0.02)


def test_one_instrument_is_one_level_and_changes_nothing(campaign: Path) -> None:
    evidence = evidence_of(campaign)

    noise = instruments([evidence, evidence_of(campaign, "judge")])

    assert noise.plain
    assert not len(with_noise(evidence, noise).noise_ratio)
    assert without_outliers(evidence) is evidence


def test_captures_show_the_noise_of_their_instrument_like_the_ball_at_rest(campaign: Path) -> None:
    evidence = evidence_of(campaign)
    noisy = with_noise(evidence, instruments([evidence]))

    sigma_i, _ = sensor_noise(noisy)
    error_i, error_x = noise_errors(noisy)

    rest_i, rest_x = noise_errors(evidence)  # of the ball at rest only: it is not known which levels are equal
    assert error_i < 0.7 * rest_i
    assert error_x == rest_x
    assert sigma_i == pytest.approx(I_A, rel=4.0 * error_i)


def test_captures_of_a_noisier_instrument_say_nothing_about_the_ball_at_rest(campaign: Path, tmp_path: Path) -> None:
    folder = copy_of(campaign, tmp_path)
    worse(folder, "step_*", i_c=Instrument(noise=I_A * math.sqrt(SCOPE**2 - 1.0), lowest=NO_LESS))
    evidence = evidence_of(folder)

    noisy = with_noise(evidence, instruments([evidence]))

    assert sensor_noise(noisy)[0] == sensor_noise(evidence)[0]


@pytest.mark.sample
def test_an_oscilloscope_beside_the_board_has_a_noise_of_its_own(campaign: Path, tmp_path: Path) -> None:
    folder = copy_of(campaign, tmp_path)
    worse(folder, "step_*", i_c=Instrument(noise=I_A * math.sqrt(SCOPE**2 - 1.0), lowest=NO_LESS))

    diagnosis = answer(folder)

    assert_diagnosed(diagnosis)
    noise = to_json(diagnosis)["noise"]["i_c"]
    scope = next(entry for entry in noise["instruments"] if "step_1.csv.gz" in entry["recordings"])
    assert scope["sigma"] == pytest.approx(SCOPE * I_A, rel=0.1)
    assert noise["sigma"] == pytest.approx(I_A, rel=0.1)


@pytest.mark.sample
def test_judges_of_a_noisier_session_do_not_speak_against_the_cause(campaign: Path, tmp_path: Path) -> None:
    folder = copy_of(campaign, tmp_path)
    worse(folder, "closed_loop_[5-8]", i_c=Instrument(noise=I_A, lowest=NO_LESS), x=Instrument(noise=X_M))

    diagnosis = answer(folder)

    assert_diagnosed(diagnosis)
    assert diagnosis.fit_evidence.noise is not None
    later = level_of(diagnosis.fit_evidence.noise.channels[1], "closed_loop_6.csv.gz", flies=True)
    assert later.ratio == pytest.approx(math.sqrt(2.0), rel=0.1)


@pytest.mark.slow
def test_outliers_of_ten_times_the_noise_are_left_out(campaign: Path, tmp_path: Path) -> None:
    folder = copy_of(campaign, tmp_path)
    share = 0.005
    worse(
        folder,
        "*",
        i_c=Instrument(outlier_share=share, outlier_size=10.0 * I_A, lowest=NO_LESS),
        x=Instrument(outlier_share=share, outlier_size=10.0 * X_M),
    )
    before = evidence_of(folder)

    after = without_outliers(before)
    diagnosis = answer(folder)

    clean = evidence_of(campaign).series
    for use, was, now, sigma in ((USE_I, clean.i, before.series.i, I_A), (USE_X, clean.x, before.series.x, X_M)):
        used = before.series.flags & use != 0
        wild, removed = used & (np.abs(now - was) > 8.0 * sigma), used & (after.series.flags & use == 0)
        assert np.count_nonzero(wild & removed) > 0.85 * np.count_nonzero(wild) > 20
        assert np.count_nonzero(removed & ~wild) <= 2
    assert sum(usage.outliers for usage in after.usages) > sum(usage.outliers for usage in before.usages)
    assert_diagnosed(diagnosis)


@pytest.mark.sample
def test_heavy_tails_bring_no_other_answer(campaign: Path, tmp_path: Path) -> None:
    folder = copy_of(campaign, tmp_path)
    tail = Instrument(noise=1.5 * I_A, tail=4.0, lowest=NO_LESS)
    worse(folder, "*", i_c=tail, x=Instrument(noise=1.5 * X_M, tail=4.0))

    assert_diagnosed(answer(folder))


@pytest.fixture(scope="module")
def higher(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sensor is noisier the higher the ball."""
    folder = copy_of(campaign, tmp_path_factory.mktemp("higher"))
    worse(folder, "[!s]*", x=Instrument(slope=SLOPE))
    return folder


@pytest.mark.sample
def test_noise_that_grows_with_the_height_is_no_cause(higher: Path) -> None:
    assert_diagnosed(answer(higher))


def test_noise_that_grows_with_the_height_is_seen(higher: Path) -> None:
    noise = instruments([evidence_of(higher), evidence_of(higher, "judge")])
    heights = np.array([0.0, 0.5, 0.7]) * RIG.travel_m

    assert np.exp(noise.channels[1].log_at(heights)) == pytest.approx(np.hypot(1.0, SLOPE * heights / X_M), rel=0.15)


def test_recordings_that_name_one_instrument_share_its_level(campaign: Path) -> None:
    evidence = evidence_of(campaign)
    named = [replace(record, instrument="board" if record.has("x") else "scope") for record in evidence.records]

    noise = instruments([gather(named, load(campaign).plant)])

    assert {name for channel in noise.channels for level in channel.levels for name in level.sources} == {
        "board",
        "scope",
    }


def test_a_reading_that_is_twice_as_noisy_weighs_as_one_of_a_sensor_that_is() -> None:
    criterion = criterion_of(narrow(THETA, seconds=2.0))
    samples = criterion.evidence.samples
    system = replace(THETA, sigma_x_m=2.0 * THETA.sigma_x_m).system(PLANT, criterion.tick_s)
    noisier = samples._replace(noise_ratio=np.tile((1.0, 4.0), (len(samples.u), 1)))
    plain = THETA.system(PLANT, criterion.tick_s)

    from_system, from_samples = filtered(system, samples).innovations, filtered(plain, noisier).innovations

    np.testing.assert_array_equal(from_samples, from_system)
    predicted = np.arange(len(samples.u)) > 300
    assert floor_rmse(plain, noisier, 10, predicted) == floor_rmse(system, samples, 10, predicted)
    criterion.close()


def test_a_capture_is_told_from_the_samples_beside_it() -> None:
    criterion = criterion_of(narrow(THETA, seconds=2.0))
    evidence = criterion.evidence
    captured = next(record for record in evidence.records if record.captures)
    level = Level(sources=(f"{captured.name}, captures",), flies=False, ratio=3.0, error=0.02)

    noise_ratio = Noise((Channel(levels=(level,)), Channel())).noise_ratio(evidence.records, evidence.series)

    is_fast = (evidence.series.step > 0.0) & (evidence.series.step < 1e-4)
    np.testing.assert_allclose(noise_ratio[is_fast, 0], 9.0)
    np.testing.assert_array_equal(noise_ratio[~is_fast], 1.0)
    criterion.close()
