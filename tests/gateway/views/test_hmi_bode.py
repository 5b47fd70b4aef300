"""The card of `board51 bode` on the page of a rig's model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, expect

from gateway.views.hmi.html.bode import BOTTOM, LEFT, RIGHT, TOP, bode_card
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM
from tests.harness.gateway.hmi_peers import hmi
from tests.patience import HANG_MS
from twin.model.parameters import Model

F_HZ = [1.0, 2.0, 4.0]
CAMPAIGN = "rig-20260102-030405"


def answer(**changes: Any) -> dict[str, Any]:
    """A bode.json: the measured plant has twice the gain of the model, and its last point is no measurement."""
    measured = {"f_hz": F_HZ, "gain": [4e-3, 2e-3, 1e-3], "phase_deg": [175.0, -170.0, 10.0]}
    model = {"f_hz": F_HZ, "gain": [2e-3, 1e-3, 5e-4], "phase_deg": [180.0, 185.0, 190.0]}
    uncertain = {"gain_std": [1e-4, None, 0.0], "phase_std_deg": [1.0, None, 0.0]}
    height = {
        "x_m": 2.85e-3,
        "measured": {"plant": measured | {"radius95": [4e-4, 2e-4, 2e-3]}},
        "model": {"plant": model | uncertain, "loop": model | uncertain},
    }
    return {"answer": "It does not.", "explains": False, "heights": [height], "notes": ["a note"]} | changes


def test_gain_and_phase_stand_beside_the_model() -> None:
    card = bode_card(answer())

    assert card is not None
    assert (card["answer"], card["explains"], card["notes"]) == ("It does not.", False, ["a note"])
    ((mm, (gain, phase)),) = card["heights"]
    assert mm == "2.85"
    assert len(gain.points) == len(gain.line) == 2, "where the interval holds 0 nothing was measured"
    labels = {text: y for y, text in gain.grid}
    assert gain.points[1][1] == pytest.approx(labels["2"]), "2 mm/V"
    assert gain.line[1][1] == pytest.approx(labels["1"])
    assert gain.line[0][2] > gain.line[0][1] > gain.line[0][3], "its band"
    for at, _, bottom, top in [*gain.points, *phase.points]:
        assert LEFT < at < RIGHT
        assert BOTTOM >= bottom > top >= TOP
    # 175 and -170 degrees stand beside -180 and -175, that is at -185 and -170.
    assert phase.points[0][1] > phase.line[0][1]
    assert phase.points[1][1] < phase.line[1][1]
    assert all(float(text) < 0.0 for _, text in phase.grid)


@pytest.mark.parametrize(
    "damaged",
    [{}, {"answer": "a"}, answer(heights=[{"x_m": None}]), answer(heights=3), answer(heights=[[]])],
)
def test_what_is_no_bode_json_is_not_shown(damaged: dict[str, Any]) -> None:
    assert bode_card(damaged) is None


@pytest.mark.slow
@pytest.mark.xdist_group("hmi-seen")
@pytest.mark.skipif(CHROMIUM is None, reason=ABSENT)
def test_the_button_compares_and_the_card_says_what_is_missing(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "data" / "campaigns" / CAMPAIGN
    folder.mkdir(parents=True)
    plant = '[plant]\nname = "ce152"\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\nx_max_m = 5.7e-3\n'
    (folder / "campaign.toml").write_text(
        f'{plant}[[recording]]\nfile = "rest.csv"\nkind = "closed-loop"\nuse = "judge"\n'
    )
    rows = [f"{n * 2e-3:.3f},2.1,0.6,0.00285,0.00285" for n in range(2000)]
    (folder / "rest.csv").write_text("\n".join(["t,u_c,i_c,x,x_ref", *rows]))
    Model.load("ce152").save(folder / "model.json")
    with played_gateway() as gateway, hmi(tmp_path, gateway.endpoint) as (port, _), ticking(gateway, "rig"):
        page = browser.new_page()
        page.set_default_timeout(HANG_MS)
        page.goto(f"http://127.0.0.1:{port}/model/rig")

        page.get_by_role("button", name="Bode", exact=True).click()

        expect(page.locator('[data-live="bode-said"]')).to_contain_text("done")
        card = page.locator(".card", has=page.get_by_text("Full report with all responses"))
        expect(card).to_contain_text(json.loads((folder / "bode" / "bode.json").read_text())["answer"])
        expect(card.get_by_role("button", name="Record bode-low")).to_be_visible()
        card.get_by_role("link").click()
        expect(page.frame_locator("iframe").locator("h1")).to_contain_text("Frequency responses")
        page.goto(f"http://127.0.0.1:{port}/logs")
        expect(page.get_by_text(f"rig, campaign {CAMPAIGN}: frequency responses")).to_be_visible()
        page.close()
