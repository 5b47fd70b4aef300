"""The purpose of the campaign: its folder gives back the emulated rig and says nothing against its own recordings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import board51
from gateway.config import LimitsConfig
from gateway.emulator.plant.constants import CE152
from gateway.emulator.plant.magnetoshield import MAGNETOSHIELD
from tests.harness.gateway.campaign_line import emulated_line

TRUTH = {
    "K_A": CE152.amplifier_gain_a_v,
    "T_A": CE152.amplifier_time_constant_s,
    "K_c": CE152.force_constant_n_m2_a2,
    "b": CE152.drag_n_s_m,
}


@pytest.mark.slow
def test_the_default_campaign_gives_the_rig_back_and_its_judges_agree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, model = tmp_path / "c", tmp_path / "model.json"
    with emulated_line(tmp_path, seed=7) as line:
        assert line.run(folder) == 0
    capsys.readouterr()

    assert board51.main(["identify", str(folder), "--out", str(model)]) == 0

    captured = capsys.readouterr()
    assert not [text for text in captured.out.splitlines() + captured.err.splitlines() if text.startswith("!")]
    parameters = json.loads(model.read_text())["parameters"]
    for name, true in TRUTH.items():
        parameter = parameters[name]
        assert parameter["verdict"] == "identified", name
        # 4 standard errors: one good campaign in 4000 would fail for one of the four parameters.
        assert abs(parameter["value"] - true) < 4 * parameter["std"], (name, parameter)
    assert board51.main(["validate", str(folder), "--model", str(model), "--out", str(tmp_path / "v")]) == 0
    assert "The model explains these recordings" in capsys.readouterr().out


@pytest.mark.slow
def test_of_a_magnetoshield_the_amplifier_is_found_and_the_force_law_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, model = tmp_path / "c", tmp_path / "model.json"
    known = '[plant]\nname = "magnetoshield"\nmass_kg = 7.34e-4\ntravel_m = 5e-3\nx_max_m = 17e-3\n'
    limits = LimitsConfig(x_ref_min_m=0.5e-3, x_ref_max_m=4.5e-3, u_max_v=10.0)
    with emulated_line(tmp_path, rig="magnetoshield", known=known, limits=limits) as line:
        assert line.run(folder, "--quick") == 0
    capsys.readouterr()

    assert board51.main(["identify", str(folder), "--out", str(model)]) == 0

    parameters = json.loads(model.read_text())["parameters"]
    assert parameters["K_A"]["value"] == pytest.approx(MAGNETOSHIELD.amplifier_gain_a_v, rel=0.005)
    assert parameters["T_A"]["value"] == pytest.approx(MAGNETOSHIELD.amplifier_time_constant_s, rel=0.05)
    # A permanent magnet is pulled in proportion to i, not to its square: (3) has no K_c for it, nor a drag.
    assert parameters["b"]["verdict"] == "not-identifiable"
    assert "(3) does not hold over the whole travel" in capsys.readouterr().out
