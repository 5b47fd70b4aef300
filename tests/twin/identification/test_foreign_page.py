"""The smallest campaign of docs/howto/foreign.md, played by a rig that fits it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import board51
from tests.harness.twin.independent_plant import Ball, wandering
from twin.model.parameters import Model

PAGE = Path(__file__).parents[3] / "docs" / "howto" / "foreign.md"


def test_the_smallest_campaign_of_the_page_is_identified_and_predicted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    section = PAGE.read_text(encoding="utf-8").partition("## The least that works")[2]
    block = re.search(r"```toml\n(.*?)```", section, re.DOTALL)
    assert block is not None
    (tmp_path / "campaign.toml").write_text(block[1], encoding="utf-8")
    rig = Ball(m=0.0084, travel=6.0e-3, x_max=8.4e-3)
    for n, name in enumerate(("monday", "tuesday")):
        flight = rig.closed_loop(wandering(n, 2500), 2500, seed=n)
        rows = np.column_stack((flight.t * 1e3, flight.u_c / 12.0, flight.i_c * 1e3, (rig.travel - flight.x) * 1e3))
        header = "time_ms,duty,current_mA,gap_mm"
        np.savetxt(tmp_path / f"{name}.csv", rows, fmt="%.9g", delimiter=",", header=header, comments="")
    model, ahead = tmp_path / "model.json", tmp_path / "ahead.csv"

    identified = board51.main(["identify", str(tmp_path), "--out", str(model), "--quiet"])
    predicted = board51.main(
        ["predict", str(model), "tuesday.csv", "--campaign", str(tmp_path), "--horizon", "10", "--out", str(ahead)]
    )

    capsys.readouterr()
    assert (identified, predicted) == (0, 0)
    K_c = Model.load(model).parameters["K_c"]
    assert K_c.std is not None
    assert abs(K_c.value - rig.K_c) < 4 * K_c.std
    assert len(ahead.read_text().splitlines()) > 2000
