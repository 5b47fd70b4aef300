"""The files of a campaign with a design, as the page of a model finds them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

CAMPAIGN, DESIGN = "rig-20260102-030405", "20260103-040506"
MODEL: dict[str, Any] = {"plant": {"name": "ce152"}, "parameters": {"K_A": {"value": 0.297}}, "causes": []}
GAINS = [0.39, 1761.0, 32.8, -11901.0]
CONTROLLER: dict[str, Any] = {
    "law": "lqi", "gains": GAINS, "operating_point": {"i_0_a": 0.49, "x_0_m": 2.85e-3, "u_0_v": 1.65},
    "sample_time_s": 2e-3,
}  # fmt: skip
LOOP = {"stable": True, "gain_margin": [0.36, None], "phase_margin_deg": 24.5, "delay_margin_s": 1.96e-3,
        "x_rms_m": 4.7e-6, "u_rms_v": 0.161}  # fmt: skip
ANALYSIS = CONTROLLER | {
    "on_board": [{"value": gain} for gain in GAINS],
    "loops": [LOOP] * 3, "before": LOOP | {"stable": False}, "warnings": ["small phase margin: 24 deg"],
    "causes": ["without them: i_c = 0.4 A"],
}  # fmt: skip
FORECAST = {
    "answer": "The ball is lost in 3 of 100 draws.", "lost": 3, "notes": ["Plant assumed."],
    "figures": [
        {"name": "overshoot", "recorded": 0.25, "value": 0.1, "ci95": [0.05, 0.15], "flown": 0.12},
        {"name": "settling_s", "recorded": None, "value": None, "ci95": [None, None], "flown": None},
    ],
}  # fmt: skip


def campaign(data: Path) -> Path:
    folder = data / "campaigns" / CAMPAIGN
    folder.mkdir(parents=True)
    (folder / "campaign.toml").write_text("[plant]\n")
    (folder / "model.json").write_text(json.dumps(MODEL))
    return folder


def designed(folder: Path, *, x_0_m: float = 2.85e-3) -> Path:
    made = folder / "designs" / DESIGN
    made.mkdir(parents=True, exist_ok=True)
    point = {"operating_point": CONTROLLER["operating_point"] | {"x_0_m": x_0_m}}
    (made / "model.json").write_text(json.dumps(MODEL))
    for name, table in (("controller", CONTROLLER | point), ("analysis", ANALYSIS | point), ("what_if", FORECAST)):
        (made / f"{name}.json").write_text(json.dumps(table))
    return made
