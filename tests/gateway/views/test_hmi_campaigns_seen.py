"""Tests of the model and report pages, as a person sees and presses them in a real browser; the gateway is played."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.hmi_peers import hmi

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-seen"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
OLD, INTERRUPTED, FAILED = (f"rig-2026010{day}-030405" for day in (2, 3, 4))
OF_TWO = "two-20260101-030405"
T_A = {"value": 3.5e-4, "unit": "s", "ci95": [3e-4, 4e-4], "verdict": "identified"}
MODEL = {"name": "m", "plant": {"assumed": True}, "parameters": {"K_A": 0.297, "K_c": 1.46e-6, "b": 0.02, "T_A": T_A}}
PLANT = "[plant]\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\nassumed = true\n"


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaigns")
    answer = json.dumps({"verdict": "adequate", "sentence": "The model is right.", "plant_assumed": True})
    report = "<!doctype html><body><p style='height:2000px'>long</p>"
    root = folder / "data" / "campaigns"
    finished = {"campaign.toml": PLANT, "rest.mcap": "", "run.json": '{"left": [], "quick": true}'}
    analysed = {"model.json": json.dumps(MODEL), "diagnosis/diagnosis.json": answer, "diagnosis/report.html": report}
    write(root / OLD, finished | analysed)
    write(root / INTERRUPTED, finished | {"run.json": '{"left": ["steps", "chirp"], "quick": true}'})
    write(root / FAILED, {"acts.jsonl": '{"at": "2026-01-04 03:04", "who": "ana", "what": "began a campaign"}\n'})
    write(root / OF_TWO, {"diagnosis/report.html": report})
    write(root / "away-20260101-030405", {"diagnosis/report.html": report})
    write(folder / "logs", {"a.mcap": "not a log"})
    return folder


@pytest.fixture(scope="module")
def served(data: Path) -> Iterator[tuple[PlayedGateway, str]]:
    with played_gateway() as gateway, hmi(data, gateway.endpoint) as (port, _), ticking(gateway, "rig", "two"):
        yield gateway, f"http://127.0.0.1:{port}"


@pytest.fixture
def page(browser: Browser, served: tuple[PlayedGateway, str]) -> Iterator[Page]:
    with open_tab(browser, width=1440, url=served[1]) as page:
        page.goto("/")
        expect(page.locator(".board-card")).to_have_count(2)
        yield page


def test_a_campaign_that_failed_is_not_shown_in_place_of_a_result_and_an_interrupted_one_can_be_continued(
    page: Page,
) -> None:
    page.goto("/model/rig")

    expect(page.get_by_text("The model is right.")).to_be_visible()
    chosen = page.locator("[aria-current=true]")
    expect(chosen).to_have_attribute("href", f"/model/rig?campaign={OLD}")
    rows = page.locator(".file", has=page.locator("a[href*='campaign=']"))
    expect(rows).to_have_count(3)
    expect(rows.filter(has=page.get_by_role("button", name="Continue"))).to_contain_text("1 recording, not finished")

    page.goto(f"/model/rig?campaign={FAILED}")
    expect(page.get_by_text("It has no recordings.").first).to_be_visible()
    expect(page.get_by_role("button", name="Identify")).to_be_disabled()


def test_results_come_before_consoles_and_a_campaign_gets_a_name(page: Page) -> None:
    page.goto("/model/rig")
    card = page.locator(".card", has_text="Identified parameters")

    expect(card.locator("tr", has_text="T_A")).to_contain_text("0.000300 to 0.000400")
    expect(page.get_by_role("button", name="Validate")).to_be_enabled()
    expect(page.locator("button", has_text="Investigate")).to_have_class("filled")
    expect(page.locator(".job-lines").first).to_be_hidden()

    row = page.locator(".file", has=page.locator(f"a[href$='{INTERRUPTED}']"))
    row.get_by_text("Rename or delete").click()
    row.get_by_label("name").fill("before the new ball")
    row.get_by_role("button", name="Rename").click()
    expect(row.get_by_role("link", name="before the new ball")).to_be_visible()
    expect(row).to_contain_text("Campaign of 2026-01-03 03:04")

    page.goto(f"/model/rig?campaign={FAILED}")
    expect(page.get_by_role("button", name="Validate")).to_be_disabled()
    expect(page.get_by_role("button", name="Diagnose", exact=True)).to_be_disabled()


def test_while_the_ball_flies_a_campaign_is_offered_with_its_landing(page: Page) -> None:
    page.goto("/model/rig")

    expect(page.get_by_role("button", name="Park and run quick")).to_be_visible()
    expect(page.get_by_role("button", name="Run quick", exact=False)).to_have_count(1)
    expect(page.get_by_role("button", name="Investigate")).to_be_hidden()


def test_an_assumed_plant_stands_beside_k_c_and_b(page: Page, served: tuple[PlayedGateway, str]) -> None:
    served[0].send("twin/model", pb.TwinModel(name="m", sha256="0" * 64, model_json=json.dumps(MODEL)))
    page.goto("/model/rig")

    values = "K_A 0.297, K_c 1.46e-06 (plant assumed), b 0.02 (plant assumed)"
    expect(page.locator(".results").get_by_text(values)).to_be_visible()
    expect(page.locator(".work").get_by_text(values)).to_be_visible()
    expect(page.get_by_text("nobody had stated the plant of this rig")).to_be_visible()
    expect(page.get_by_text("K_c and b of this result hold for a published CE 152 only")).to_be_visible()


def test_a_double_click_is_one_press_and_the_same_refusal_is_shown_once(page: Page) -> None:
    page.goto("/model/rig")
    posts: list[str] = []
    page.on("request", lambda request: posts.append(request.url) if request.method == "POST" else None)

    def identify(*, clicks: int = 1) -> None:
        button = page.get_by_role("button", name="Identify")
        button.click(click_count=clicks)
        expect(button).not_to_have_attribute("aria-busy", "true")

    page.evaluate("document.querySelector('[data-job*=identify]').dataset.job ="
                  " JSON.stringify({kind: 'identify', act: 'start', campaign: 'none'})")  # fmt: skip
    identify(clicks=2)
    expect(page.locator(".toast[data-state=bad]")).to_have_count(1)
    assert len(posts) == 1
    with page.expect_response("**/job"):
        identify()
    expect(page.locator(".toast:not([data-state=bad])")).to_have_count(0)

    expect(page.locator(".toast[data-state=bad]")).to_have_count(1)


@pytest.mark.parametrize(("campaign", "stopped"), [(OF_TWO, {"two"}), ("away-20260101-030405", {"rig", "two"})])
def test_the_report_of_a_rig_stops_that_rig(
    campaign: str, stopped: set[str], page: Page, served: tuple[PlayedGateway, str]
) -> None:
    gateway = served[0]
    gateway.commands.clear()
    page.goto(f"/report/1/campaigns/{campaign}/diagnosis/report.html")
    words = "STOP two" if stopped == {"two"} else "STOP all rigs"  # nobody waits for a rig that is not here
    assert " ".join(page.locator("button.stop").inner_text().split()) == words

    page.keyboard.press("Escape")

    expect(page.locator('[data-live="stop-said"]')).to_contain_text("STOP accepted")
    assert {key.split("/")[1] for key, command in gateway.commands if command.HasField("stop")} == stopped


@pytest.mark.parametrize("size", [(1440, 500), (390, 844)])  # too low, and too narrow
def test_a_summary_opens_where_all_of_it_is_seen(size: tuple[int, int], page: Page) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.goto("/logs")
    page.get_by_role("button", name="Summary").first.click()
    expect(page.locator("dialog.summary")).to_contain_text("is not an MCAP file")
    page.locator(".summary-text").evaluate("(e) => { e.textContent = 'a line\\n'.repeat(500); }")

    covered = page.evaluate("""() => {
        const dialog = document.querySelector('dialog.summary'), box = dialog.getBoundingClientRect();
        const heights = [box.top + 3, box.top + box.height / 2, box.bottom - 3];
        return heights.map((y) => dialog.contains(document.elementFromPoint(box.left + box.width / 2, y)));
    }""")

    assert covered == [True, True, True]
    page.get_by_role("button", name="Close").click()
    expect(page.locator("dialog.summary")).to_be_hidden()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_alarms_that_are_gone_are_not_counted_as_alarms(page: Page, served: tuple[PlayedGateway, str]) -> None:
    gateway = served[0]

    def send(number: int, *, active: bool) -> None:
        gateway.send("twin/alarm", pb.Alarm(name=f"alarm-{number}", active=active, text="wrong"), "two")

    page.goto("/rig/two")
    chip = page.locator('[data-live="alarm-count"]')
    for number in range(3):
        send(number, active=True)
    # On a busy machine samples may have been missing for a while: an alarm of the link is gone, too.
    expect(chip).to_have_text(re.compile("\u25b2 3 alarms"))
    send(0, active=False)
    expect(chip).to_have_text(re.compile("\u25b2 2 alarms \u00b7 [12] gone, not acknowledged"))
    send(1, active=False)
    send(2, active=False)

    expect(chip).to_have_text(re.compile("\u25bd no alarms \u00b7 [34] gone, not acknowledged"))
    page.goto("/")
    card = page.locator(".board-card", has_text="STOP two")
    expect(card.locator(".board-alarms")).to_have_text(re.compile("\u25bd no alarms \u00b7 [34] gone"))
    expect(card).to_have_attribute("data-state", "warn")
