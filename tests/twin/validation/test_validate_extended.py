"""Validation of models with causes on campaigns of the emulated rig that has them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import board51
from tests.harness.diagnose import known_diagnosis
from tests.harness.diagnose.hidden_campaign import draw_rig, make_campaign
from tests.harness.diagnose.simulated_rig import THETA, strong
from tests.harness.twin.true_model import true_model
from twin.diagnosis.report.model_file import model_of
from twin.validation.source import source_of

SEED = 3
EFFECTS = {"air-gap-offset": 3e-4, "actuation-delay": 1e-3, "amplifier-offset": 0.03}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    make_campaign(folder, effects=EFFECTS, seed=SEED, plant="emulator", quick=True)
    return folder


def run_validation(campaign: Path, folder: Path, effects: dict[str, float]) -> tuple[int, dict[str, Any]]:
    model = true_model(draw_rig(SEED), effects)
    # The emulated rig has no process noise; with more than it has the residuals would be coloured.
    model = replace(model, noise=replace(model.noise, process_a_m_s2=2e-3, process_i_c_a=1e-5))
    folder.mkdir()
    (folder / "model.json").write_text(json.dumps(model.to_json()))
    code = board51.main(["validate", str(campaign), "--model", str(folder / "model.json"), "--out", str(folder)])
    return code, json.loads((folder / "validation.json").read_text())


@pytest.mark.slow
def test_a_model_with_the_causes_of_the_rig_passes_where_one_without_fails(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Errors at the noise floor (its own tolerance is 5 %), i_c of the amplifier's steps as measured."""
    plain_code, plain = run_validation(campaign, tmp_path / "plain", {})
    code, extended = run_validation(campaign, tmp_path / "extended", EFFECTS)

    assert plain_code == 1
    assert code == 0, capsys.readouterr().out
    assert all(row["ratio"] < 1.1 for row in extended["ahead"])
    assert extended["amplifier"]["rmse_a"] < 0.5 * plain["amplifier"]["rmse_a"]


@pytest.mark.parametrize(("known", "unknown"), [(True, 0), (False, 1)])
def test_a_delay_among_the_causes_of_the_model_is_known(known: bool, unknown: int) -> None:
    delay = strong("actuation-delay", 2.5e-3)
    record = known_diagnosis.steps(delay, seed=1, seconds=6.0)
    fit = known_diagnosis.fit_of(delay if known else THETA, 0.0)
    model = model_of(known_diagnosis.campaign(), fit, {}, [record], 0.0, "the rig itself")

    assert source_of(record, model).unknown_delay == unknown
