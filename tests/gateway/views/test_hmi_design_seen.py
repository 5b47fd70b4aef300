"""Tests of the page's buttons from a model to gains on the board, on an emulated rig; and of a choice of two models."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Page, expect

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab, start_job
from tests.harness.gateway.gateway_peers import Bus, client, wait_for
from tests.harness.gateway.hmi_peers import Process
from tests.harness.gateway.rig_peers import Rig, emulated_rig
from tests.harness.twin.true_model import true_model
from tests.patience import WORK_MS

pytestmark = [
    pytest.mark.xdist_group("hmi-design"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
    pytest.mark.slow,
]
CAMPAIGN = "rig-20260102-030405"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A rig with a campaign of two flights, its model, and a worse one that the twin had before."""
    with emulated_rig(tmp_path_factory.mktemp("hmi-design")) as rig:
        folder = rig.folder / "data" / "campaigns" / CAMPAIGN
        words = ("campaign", "run", str(folder), "--board", "rig", "--connect", rig.endpoint, "--quick")
        with Process(rig.folder, *words, "--experiment", "steps", "--experiment", "wide-steps-judge") as process:
            assert process.wait() == 0, process.log_file.read_text()
        model = true_model()
        model.save(folder / "model.json")
        stronger = replace(model.parameters["K_c"], value=1.05 * model.parameters["K_c"].value)
        model_folder = rig.folder / "data" / "models" / "rig"
        model_folder.mkdir(parents=True)
        replace(model, parameters={**model.parameters, "K_c": stronger}).save(model_folder / "20260101-000000.json")
        yield rig


@pytest.fixture
def bus(rig: Rig) -> Iterator[Bus]:
    with client(rig.endpoint) as bus:
        wait_for(lambda: bus.states() and bus.messages["rig/parameters"], "samples and parameters")
        yield bus


@pytest.fixture
def page(browser: Browser, rig: Rig) -> Iterator[Page]:
    with open_tab(browser, width=1440) as page:
        page.goto(f"{rig.url}/model/rig")
        page.wait_for_selector("body[data-live=yes]")
        yield page


def parameters(bus: Bus) -> pb.Parameters:
    made: pb.Parameters = bus.messages["rig/parameters"][-1]
    return made


def test_a_design_is_shown_loaded_and_flown(page: Page, rig: Rig, bus: Bus) -> None:
    before = list(parameters(bus).gains)
    page.get_by_label("settling time").fill("50")
    start_job(page, "Design")
    card = page.locator(".card", has_text="Margins on the model")
    margin = card.get_by_role("row", name="phase margin, deg")
    expect(margin).to_have_text(re.compile(r"phase margin, deg47\.\d+41\.\d+"), timeout=WORK_MS)
    # The card is there before its process has ended.  A page that is drawn anew under a press does not lose it.
    button = page.get_by_role("button", name="Predict the flight", exact=True)
    button.hover(timeout=WORK_MS)
    page.mouse.down()
    with page.expect_response(f"{rig.url}/model/rig"):
        button.evaluate("(button) => { button.title = 'old'; document.dispatchEvent(new Event('board51-changed')); }")
    with page.expect_response("**/job"):
        page.mouse.up()
    expect(card).to_contain_text("The ball stays in flight.", timeout=WORK_MS)

    # A refused load leaves gains and ball as they were.
    assert bus.command("fly", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)).accepted
    wait_for(lambda: abs(bus.states()[-1].x_m - bus.states()[-1].x_ref_m) < 50e-6, "flight")
    load = card.get_by_role("button", name="Load on the board")
    load.evaluate("""(button) => {
        const command = JSON.parse(button.dataset.command);
        command.set_gains.gains[1] = 1e9;
        button.dataset.command = JSON.stringify(command);
    }""")
    load.click()
    expect(page.locator(".toast[data-state=bad]")).to_contain_text("gain 2 = 1e+09 is above")
    count = len(bus.states())
    flown = wait_for(lambda: bus.states()[count:] if len(bus.states()) > count + 250 else None, "half a second")
    assert max(abs(state.x_m - state.x_ref_m) for state in flown) < 100e-6
    assert list(parameters(bus).gains) == before

    page.reload()
    page.keyboard.press("Escape")  # STOP: loading in idle is the safest
    wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")
    page.get_by_role("button", name="Load on the board", exact=True).click(timeout=WORK_MS)
    expect(card.locator(".in-use")).to_be_visible(timeout=WORK_MS)
    (made,) = (rig.folder / "data" / "campaigns" / CAMPAIGN / "designs").iterdir()
    designed = json.loads((made / "controller.json").read_text())["gains"]
    assert list(parameters(bus).gains) == pytest.approx(designed, rel=1e-4)
    assert before != pytest.approx(designed, rel=1e-2)

    start_job(page, "Fly the steps again")
    start_job(page, "Compare with the forecast")
    expect(card).to_contain_text("figures of the flight that followed", timeout=WORK_MS)
    figures = json.loads((made / "what_if.json").read_text())["figures"]
    flown_figures = {figure["name"]: figure for figure in figures if figure["flown"] is not None}
    assert {"overshoot", "settling_s", "effort_v2_s"} <= set(flown_figures)
    held = [figure["ci95"][0] <= figure["flown"] <= figure["ci95"][1] for figure in flown_figures.values()]
    assert sum(held) >= len(held) - 2, flown_figures
    page.get_by_role("link", name="Full forecast with plots").click()
    expect(page.frame_locator("iframe").get_by_role("heading", name="What if")).to_be_visible()


def test_a_design_that_is_not_stable_gives_no_gains_and_says_why(page: Page) -> None:
    page.get_by_label("settling time").fill("0.001")
    start_job(page, "Design")

    expect(page.locator('[data-live="design-said"]')).to_contain_text("ended incomplete", timeout=WORK_MS)
    expect(page.locator('[data-live="design-lines"]')).to_contain_text("the loop on the board is UNSTABLE")
    expect(page.get_by_text("This design gave no gains.")).to_be_visible()
    expect(page.get_by_role("button", name="Load on the board")).to_have_count(0)


def test_two_models_are_chosen_and_compared(page: Page) -> None:
    start_job(page, "Compare")

    card = page.locator(".results .card", has_text="Last comparison")
    expect(card).to_contain_text("emulated (no. 2) predicts better.", timeout=WORK_MS)
    card.get_by_role("link", name="Full comparison").click()
    expect(page.frame_locator("iframe").get_by_role("heading", name="Two models on the same flights")).to_be_visible()
