"""The remainder goes from the command to the model file that other commands take: a spring that no catalogue has."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from board51 import main
from tests.harness.diagnose.agreement import disagreements
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.model.parameters import Model

pytestmark = pytest.mark.slow


def test_a_curve_takes_the_place_of_the_names_that_it_replaces_and_its_model_runs_everywhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "runs", tmp_path / "diagnosis"
    make_campaign(folder, effects={}, outside={"spring-of-a-cable": 2.0}, seed=25, plant="independent", quick=True)

    code = main(["diagnose", str(folder), "--quick", "--out", str(out), "--quiet"])

    report: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert (code, report["verdict"]) == (1, "unknown-cause")
    assert not disagreements(report)
    assert report["candidates"]
    assert all(candidate["rival"] is not None for candidate in report["candidates"])
    assert "a force that depends on the height alone" in report["sentence"]
    left = report["remainder"]
    assert left["judge"]["extended_rmse_m"] <= left["judge"]["causes_rmse_m"]
    assert left["judge"]["extended_rmse_m"] < 1.05 * left["judge"]["noise_floor_m"]
    (curve,) = left["curves"]
    assert curve["name"] == "force-over-height"
    assert np.shape(curve["at"]) == np.shape(curve["mean"]) == np.shape(curve["ci95"][0])
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "What is left, as a curve" in text
    model = Model.load(out / "extended_model.json")
    assert [cause.name for cause in model.causes] == [curve["name"]]
    assert left["beside"] == "paper"
    capsys.readouterr()

    assert (
        main(["validate", str(folder), "--model", str(out / "extended_model.json"), "--out", str(tmp_path / "v")]) == 0
    )
    assert "explains these recordings" in capsys.readouterr().out
    assert main(["design", str(out / "extended_model.json")]) == 0
    assert "force-over-height" in capsys.readouterr().out
