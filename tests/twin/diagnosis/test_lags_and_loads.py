"""Two time constants and a supply that gives in, on rigs that share no equation with the twin."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.textbook_plant import CREEPING_SHARE, DIFFUSED
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.result import Diagnosis


def _diagnosed(folder: Path) -> Diagnosis:
    diagnosis = diagnose(load(folder / "campaign.toml"), Options(quick=True))
    assert diagnosis.verdict == "causes-found"
    assert diagnosis.gain is not None
    assert diagnosis.gain.removed > 0.95
    assert diagnosis.gain.ci95_floor[0] < 1.05
    return diagnosis


@pytest.mark.sample
@pytest.mark.parametrize(("form", "tau_s", "seed"), [("current-two-times", 9e-3, 62), ("current-creeps", 0.15, 63)])
def test_a_second_time_constant_of_the_current_has_its_size(form: str, tau_s: float, seed: int, tmp_path: Path) -> None:
    make_campaign(tmp_path, effects={form: tau_s}, seed=seed, plant="textbook", quick=True)

    (cause,) = _diagnosed(tmp_path).causes

    assert cause.name == "second-time-constant"
    assert cause.parameters["share"].value == pytest.approx(CREEPING_SHARE, rel=0.03)
    assert cause.parameters["tau_s"].value == pytest.approx(tau_s, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("tau_s", "seed"), [(2.5e-3, 66), (1.54e-3, 12897)])
def test_a_filter_before_the_converter_is_not_taken_for_the_amplifier_s_lag(
    tau_s: float, seed: int, tmp_path: Path
) -> None:
    """To i_c alone both orders of the two lags are the same: only the ball tells them apart."""
    make_campaign(tmp_path, effects={"current-filtered": tau_s}, seed=seed, plant="textbook", quick=True)

    (cause,) = _diagnosed(tmp_path).causes

    assert cause.name == "current-sensor-lag"
    assert cause.parameters["tau_s"].value == pytest.approx(tau_s, rel=0.03)


@pytest.mark.sample
def test_of_a_field_that_diffuses_into_the_core_the_mean_lag_is_found(tmp_path: Path) -> None:
    tau_s = 3.5e-3
    make_campaign(tmp_path, effects={"eddy-diffusion": tau_s}, seed=64, plant="textbook", quick=True)

    (cause,) = _diagnosed(tmp_path).causes

    assert cause.name == "eddy-current-lag"
    mean = tau_s * sum(n**-4 for n in (1, 3, 5, 7)) / DIFFUSED
    assert cause.parameters["tau_s"].value == pytest.approx(mean, rel=0.03)


@pytest.mark.sample
def test_a_supply_that_gives_in_is_named_alone_with_its_time(tmp_path: Path) -> None:
    make_campaign(tmp_path, effects={}, seed=65, plant="independent", outside={"supply-sag": 0.07}, quick=True)

    (cause,) = _diagnosed(tmp_path).causes

    assert cause.name == "amplifier-gain-drift"
    assert cause.parameters["loss_1_a2"].value == pytest.approx(0.07, rel=0.05)
    assert cause.parameters["tau_s"].value == pytest.approx(1.5, rel=0.05)
    assert cause.parameters["power"].value == pytest.approx(1.0, abs=0.15)
