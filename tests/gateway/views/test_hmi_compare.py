"""Two models compared on the page: who may, and what is refused in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.harness.gateway.hmi_peers import Page, served

CAMPAIGN = "rig-20260102-030405"
MODEL: dict[str, Any] = {"plant": {"name": "ce152"}, "parameters": {"K_A": {"value": 0.297}}, "causes": []}
TOML = """[plant]
name = "ce152"
mass_kg = 8.28e-3
travel_m = 5.7e-3

[[recording]]
file = "steps.mcap"
kind = "closed-loop"
use = "USE"
"""
ANSWER = {"answer": "extended predicts better.", "names": ["identified", "extended"], "notes": ["A note."]}
FIRST, SECOND = f"{CAMPAIGN}/model.json", f"{CAMPAIGN}/extended_model.json"


def campaign(data: Path) -> Path:
    folder = data / "campaigns" / CAMPAIGN
    for part in ("diagnosis", "comparison"):
        (folder / part).mkdir(parents=True)
    (folder / "steps.mcap").write_bytes(b"")
    (folder / "campaign.toml").write_text(TOML.replace("USE", "judge"))
    (folder / "model.json").write_text(json.dumps(MODEL))
    (folder / "diagnosis" / "extended_model.json").write_text(json.dumps(MODEL | {"name": "extended"}))
    (folder / "comparison" / "compare.json").write_text(json.dumps(ANSWER))
    (folder / "comparison" / "compare.html").write_text("<p>compared")
    return folder


@pytest.mark.slow
def test_a_comparison_is_seen_by_all_made_by_an_engineer_and_refused_in_words(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "data")
    request = {"kind": "compare", "act": "start", "campaign": CAMPAIGN, "first": FIRST, "second": SECOND}
    with served(tmp_path, MODEL) as (_, port):
        viewer, engineer = Page(port), Page(port)
        viewer.log_in("vic")
        engineer.log_in("ana")
        viewer_page, able = viewer.open("/model/rig"), engineer.open("/model/rig")
        report = viewer.http.get(f"/report-file/1/campaigns/{CAMPAIGN}/comparison/compare.html")
        listed = viewer.open("/logs")
        forbidden = viewer.post("/api/rig/job", request)
        refused = {
            reason: engineer.post("/api/rig/job", request | change).json()
            for reason, change in {
                "no-model": {"second": ""},
                "same-model": {"second": FIRST},
                "no-campaign": {"campaign": "none"},
            }.items()
        }
        (folder / "campaign.toml").write_text(TOML.replace("USE", "fit"))
        refused["no-flight"] = engineer.post("/api/rig/job", request).json()
        (folder / "campaign.toml").write_text("[plant")
        refused["bad-campaign"] = engineer.post("/api/rig/job", request).json()
        (folder / "comparison" / "compare.json").write_text('{"answer": 3}')
        damaged = viewer.open("/model/rig")

    assert "extended predicts better." in viewer_page
    assert "A note." in viewer_page
    assert report.text == "<p>compared"
    assert f"campaign {CAMPAIGN}: comparison of models" in listed
    assert 'data-form="compare"' in able
    assert 'data-form="compare"' not in viewer_page
    assert (forbidden.status_code, forbidden.json()["reason"]) == (403, "not-allowed")
    assert {reason: answer["reason"] for reason, answer in refused.items()} == {reason: reason for reason in refused}
    assert refused["no-model"]["text"] == "Choose one of the models in the list first."
    assert refused["same-model"]["text"] == "Both choices are the same model. Choose two different ones."
    assert "campaign.toml" in refused["bad-campaign"]["text"]
    assert "predicts better" not in damaged
