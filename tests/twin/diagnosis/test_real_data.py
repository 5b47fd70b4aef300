"""The diagnosis on measured rigs: what their recordings say, whatever the code believes.  Skipped without the data."""

from __future__ import annotations

import functools
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from board51 import main
from protocol.campaign import load
from twin.diagnosis.judge.prediction_gain import predictions
from twin.diagnosis.pipeline import tick_of
from twin.diagnosis.remainder.curve_fits import fully_fitted, roughly_fitted, scores
from twin.diagnosis.remainder.remainder import substitutes
from twin.estimation.innovations import FLIES
from twin.evidence.gather import Evidence, gather
from twin.evidence.instruments import instruments, with_noise
from twin.evidence.outliers import without_outliers
from twin.evidence.sensor_noise import sensor_noise
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, STOPS, Theta, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.curve import CURVES
from twin.readers.campaign import read_campaign

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("BOARD51_DATA", ROOT.parent / "shared" / "data"))
CAMPAIGNS = ROOT / "twin" / "campaigns"

needs_ce152 = pytest.mark.skipif(
    not (DATA / "ce152-equilibria" / "equilibria.csv").is_file(),
    reason="no CE 152 equilibria: set BOARD51_DATA to the folder that holds ce152-equilibria",
)
needs_inteco = pytest.mark.skipif(
    not (DATA / "inteco-mls2em").is_dir(),
    reason="no INTECO recordings: set BOARD51_DATA to the folder that holds inteco-mls2em",
)

# About the rig, from the likelihood of the whole campaign; the tests ask only for changes around it.
INTECO = Theta(
    K_A=0.2383, T_A=0.0275, K_c=6.756e-5, b=2.0, sigma_i_c_a=6e-3, sigma_x_m=1.73e-5,
    process_i_c_a=3.4e-3, process_a_m_s2=1.9,
)  # fmt: skip


@functools.cache
def inteco(*names: str) -> Evidence:
    """The recordings of inteco-diagnosis.toml for fitting whose names hold one of these; all without a name."""
    campaign = load(CAMPAIGNS / "inteco-diagnosis.toml")
    records = [
        record
        for record in read_campaign(campaign, data=DATA)
        if not names or any(name in record.name for name in names)
    ]
    return gather(records, campaign.plant)


def values(evidence: Evidence, coordinate: str, sizes: tuple[float, ...], theta: Theta = INTECO) -> list[float]:
    """Log-likelihood at each size of a cause."""
    plant = load(CAMPAIGNS / "inteco-diagnosis.toml").plant
    criterion = Criterion(evidence, plant, 1e-3)
    try:
        return [criterion.value(theta.having(coordinate, size)) for size in sizes]
    finally:
        criterion.close()


@pytest.mark.slow
@needs_ce152
def test_four_equilibria_of_a_ce152(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(
        ["diagnose", str(CAMPAIGNS / "ce152-equilibria.toml"), "--data", str(DATA), "--out", str(tmp_path), "--quiet"]
    )

    diagnosis: dict[str, Any] = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert code == 0
    assert "air-gap-offset" in {diagnosis["causes"][0]["name"], *diagnosis["causes"][0]["indistinguishable_from"]}
    low, high = diagnosis["causes"][0]["parameters"]["d_m"]["ci95"]
    assert low < 2.4e-3 < high
    # (3) has the current go to 0 at x_max; the rig took 0.43 A a millimetre below it.
    assert max(abs(share) for share in diagnosis["static"]["baseline_error_share"]) > 0.4
    gain = diagnosis["gain"]["leave_one_out"]
    assert gain["extended_rmse_a"] < 0.2 * gain["baseline_rmse_a"]
    # The currents were computed from u_c: nothing here may clear the amplifier.
    assert "amplifier-offset" in diagnosis["causes"][0]["indistinguishable_from"]
    assert "air-gap-offset" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "x_max" in capsys.readouterr().out


@needs_inteco
def test_balls_on_platforms_give_currents_and_no_stops() -> None:
    evidence = inteco("force_02", "force_05", "force_17")

    assert evidence.low_m is None
    assert evidence.high_m is None
    assert not (evidence.series.flags & FLIES).any()
    assert len(evidence.statics) >= 3


@needs_inteco
def test_noise_without_a_ball_at_rest_is_what_the_rig_is_known_for() -> None:
    evidence = inteco()

    sigma_i, sigma_x = sensor_noise(with_noise(evidence, instruments([evidence])))

    assert sigma_x is not None
    assert 12e-6 <= sigma_x <= 90e-6  # its authors' range over the gap
    assert sigma_i is not None
    assert 4e-3 <= sigma_i <= 10e-3


@needs_inteco
def test_the_tick_is_that_of_the_flights() -> None:
    campaign = load(CAMPAIGNS / "inteco-diagnosis.toml")

    assert tick_of(read_campaign(campaign, data=DATA)) == pytest.approx(1e-3, rel=1e-3)


@needs_inteco
@pytest.mark.parametrize("name", ["cl_multisteps_stairs__LQI", "inductance_1.14"])
def test_the_input_acts_late_by_the_same_time_at_both_rates(name: str) -> None:
    """1 kHz flights and 200 Hz steps: a time of the rig, not a sample of its logger."""
    sizes = (0.0, 1e-3, 1.45e-3, 2e-3)

    likelihoods = values(inteco(name), "actuation-delay.delay_s", sizes)

    assert sizes[int(np.argmax(likelihoods))] == 1.45e-3
    assert max(likelihoods) > likelihoods[0] + 50.0


@needs_inteco
def test_the_current_falls_faster_than_it_rises() -> None:
    """A diode of 0.6 V, beside the 8 mA that the current sensor reads too high."""
    theta = INTECO.having("actuation-delay.delay_s", 1.45e-3).having("current-sensor-offset.offset_a", 8e-3)

    without, with_diode = values(
        inteco("inductance_1.06", "inductance_1.14"), "freewheel-diode.drop_v", (0.0, 0.6), theta
    )

    assert with_diode > without + 200.0


@needs_inteco
def test_a_clamped_ball_induces_no_voltage() -> None:
    without, strong = values(inteco("inductance_1.09"), "motional-emf.coupling_s_m", (0.0, 1.0))

    assert strong == pytest.approx(without, abs=0.1)


@needs_inteco
def test_the_coil_sits_higher_than_its_face() -> None:
    """With K_c and the process noise free in both, over the flights of one controller."""
    evidence = inteco("cl_multisteps_stairs__LQI", "cl_sinusoidal_slow__LQI")
    delayed = INTECO.having("actuation-delay.delay_s", 1.45e-3)

    def best(d_m: float) -> float:
        likelihoods = []
        for K_c in np.linspace(0.94, 1.06, 7) * INTECO.K_c * ((0.010 + d_m) / 0.010) ** 2:
            for process in (1.2, 1.9):
                theta = delayed.having("K_c", float(K_c)).having("process_a_m_s2", process)
                likelihoods += values(evidence, "air-gap-offset.d_m", (d_m,), theta)
        return max(likelihoods)

    assert best(1.8e-3) > best(0.0) + 50.0


@needs_inteco
@pytest.mark.slow
def test_the_whole_rig_is_explained_in_part_and_said_so(tmp_path: Path) -> None:
    code = main(
        ["diagnose", str(CAMPAIGNS / "inteco-diagnosis.toml"), "--data", str(DATA), "--out", str(tmp_path), "--quick"]
    )

    diagnosis: dict[str, Any] = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert code == 0
    assert diagnosis["verdict"] == "partly-explained"
    first, *others = diagnosis["causes"]
    assert first["name"] == "actuation-delay"
    assert not first["indistinguishable_from"], "a delay that varies is none of the sensors"
    assert first["parameters"]["delay_s"]["value"] == pytest.approx(1.45e-3, abs=5e-5)
    assert first["parameters"]["jitter_s"]["value"] == pytest.approx(1.1e-4, abs=3e-5)
    assert {cause["name"] for cause in others} == {"current-sensor-offset", "freewheel-diode"}
    offset = next(cause["parameters"]["offset_a"] for cause in others if cause["name"] == "current-sensor-offset")
    low, high = offset["ci95"]
    assert -0.03 < low < high < 0.03  # at rest it reads 2 to 27 mA
    assert {candidate["name"] for candidate in diagnosis["candidates"]} == {"air-gap-offset"}
    assert 0.02 < diagnosis["unexplained"]["share_of_excess"] < 0.1
    judge = diagnosis["gain"]["judge"]
    assert judge["extended_rmse_m"] < 0.35 * judge["baseline_rmse_m"]
    assert judge["excess_removed"] > 0.9
    assert judge["ci95_over_floor"][0] > 1.3


@needs_inteco
@pytest.mark.slow
@pytest.mark.sample
def test_with_the_iron_saturated_the_rig_s_own_laws_predict_to_40_micrometres() -> None:
    """Delay, wandering offset and gap law leave a pull that falls with the current, as saturated iron makes it."""
    campaign = load(CAMPAIGNS / "inteco-diagnosis.toml")
    records, judges = (read_campaign(campaign, use=use, data=DATA) for use in ("fit", "judge"))
    evidence = without_outliers(gather(records, campaign.plant))
    judge = without_outliers(gather(judges, campaign.plant, (evidence.low_m, evidence.high_m)))
    noise = instruments([evidence, judge])
    evidence, judge, tick_s = with_noise(evidence, noise), with_noise(judge, noise), tick_of(records)
    sizes = {
        "actuation-delay.delay_s": 1.45e-3, "current-sensor-offset.offset_a": 0.017,
        "current-sensor-offset.wander_a": 0.04, "force-exponent.n": 1.7,
    }  # fmt: skip
    start = replace(INTECO, K_A=0.2423, T_A=0.02726, b=0.1, causes=tuple(sizes.items()))
    names = dict.fromkeys(name.partition(".")[0] for name in sizes)
    curve = next(entry for entry in CURVES if entry.name == "pull-over-current")
    criterion = Criterion(evidence, campaign.plant, tick_s)
    try:
        free = (*BASE, *STOPS, *(name for cause in names for name in coordinates_of(cause)))
        fit = climb(criterion, start, free)
        (score,) = scores(criterion, fit, [curve])
        thetas = [fit.theta, fully_fitted(criterion, roughly_fitted(criterion, fit, score)).theta]
        (like, *_) = substitutes(criterion, fit, curve, score.evidence, [BY_NAME["core-saturation"]])
        thetas.append(like.trial.fit.theta)
    finally:
        criterion.close()
    ahead = round(0.02 / tick_s)
    errors = [predictions(judge, theta, campaign.plant, tick_s, ahead) - judge.series.x for theta in thetas]
    plain, curved, saturated = (float(np.sqrt(np.nanmean(error**2))) for error in errors)

    assert curved < 0.85 * plain
    assert saturated < 0.85 * plain
    assert saturated < 40.5e-6  # 40 um, rounded
