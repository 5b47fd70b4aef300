"""The plant card in a real browser: what is typed is judged, and another ball is identified by buttons alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from gateway.emulator.own_rig import limits_toml, load_rig
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab, start_job
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.heavy_rig import DRAGGED_RIG, TRUTH
from tests.harness.gateway.hmi_peers import hmi
from tests.harness.gateway.rig_peers import Rig, emulated_rig
from tests.patience import WORK_MS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-plant"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
NOBODY = "Assumed: nobody stated the plant of this rig."


def opened(browser: Browser, url: str) -> Iterator[Page]:
    with open_tab(browser, width=1440, url=url) as page:
        page.goto("/model/rig")
        page.wait_for_selector("body[data-live=yes]")
        yield page


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def state(page: Page, **values: str) -> None:
    """Fill in the form of the card, field by field, as a person does."""
    for name, value in values.items():
        field = page.locator(f"form[data-plant] [name={name}]")
        field.fill(value)
        field.blur()


@pytest.fixture
def played(tmp_path: Path) -> Iterator[tuple[PlayedGateway, str]]:
    with played_gateway() as gateway, hmi(tmp_path, gateway.endpoint) as (port, _), ticking(gateway, "rig"):
        yield gateway, f"http://127.0.0.1:{port}"


@pytest.fixture
def page(browser: Browser, played: tuple[PlayedGateway, str]) -> Iterator[Page]:
    yield from opened(browser, played[1])


def stated(gateway: PlayedGateway) -> list[pb.SetPlant]:
    return [command.set_plant for _, command in gateway.commands if command.HasField("set_plant")]


def test_what_is_typed_is_judged_beside_its_field_before_it_is_sent(
    page: Page, played: tuple[PlayedGateway, str]
) -> None:
    gateway, _ = played
    expect(page.get_by_text("The gateway has not sent the plant card yet.")).to_be_visible()
    gateway.send("plant", pb.PlantCard())
    expect(page.get_by_text(NOBODY)).to_be_visible()
    page.get_by_text("State the plant", exact=True).click()

    def answer(field: str) -> Any:
        return expect(page.locator(f"[data-answer={field}]"))

    state(page, mass_g="0.02", travel_mm="5.7", x_max_mm="5")
    answer("mass_g").to_contain_text("0.02 g is outside 0.1 g .. 2 kg. You may mean 20 g")
    answer("x_max_mm").to_contain_text("5 mm lies within the travel of 5.7 mm")
    press(page, "State this plant")
    answer("mass_g").to_contain_text("You may mean 20 g")
    assert stated(gateway) == []

    state(page, mass_g="20", diameter_mm="12.6", x_max_mm="8")
    answer("mass_g").to_contain_text("a steel ball of 12.6 mm weighs 8.222 g")
    expect(page.get_by_role("button", name="State this plant", exact=True)).to_be_hidden()
    press(page, "The values are right: state this plant")
    (sent,) = wait_for(lambda: stated(gateway), "the command")
    assert sent.confirmed
    assert [sent.plant.mass_kg, sent.plant.x_max_m] == pytest.approx([20e-3, 8e-3])

    state(page, diameter_mm="")
    answer("mass_g").to_have_text("")
    press(page, "State this plant")
    second = wait_for(lambda: stated(gateway)[1:], "the second command")[0]
    assert (second.confirmed, second.plant.HasField("ball_diameter_m")) == (False, False)
    gateway.send("plant", pb.PlantCard(plant=second.plant, who="ana", stated_ns=10**18))
    expect(page.get_by_text("Stated by ana")).to_be_visible()
    expect(page.get_by_text("Change the plant", exact=True)).to_be_visible()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """An emulated rig with another ball, whose gateway has its limits and knows nothing else of it."""
    file, config = tmp_path / "rig.toml", tmp_path / "gateway.toml"
    file.write_text(DRAGGED_RIG)
    config.write_text(limits_toml(load_rig(file)[1], "rig"))
    with emulated_rig(tmp_path, "--rig", str(file), config=config) as rig:
        yield rig


@pytest.fixture
def live_page(browser: Browser, rig: Rig) -> Iterator[Page]:
    yield from opened(browser, rig.url)


def fly_and_identify(page: Page, number: int, *, ends: str) -> None:
    """A campaign and an identification of it, by buttons; `ends`: what is said of the identification."""
    start_job(page, "Run quick (35 s)")
    expect(page.locator("[data-live=campaign-said]")).to_contain_text("running", timeout=WORK_MS)
    expect(page.locator("[data-live=campaign-said]")).not_to_contain_text("running", timeout=WORK_MS)
    expect(page.locator(".file", has_text="recordings")).to_have_count(number, timeout=WORK_MS)
    start_job(page, "Identify")
    expect(page.locator("[data-live=identify-said]")).to_contain_text(ends, timeout=WORK_MS)


def test_another_ball_is_identified_by_buttons_alone_once_its_plant_is_stated(live_page: Page, rig: Rig) -> None:
    page = live_page
    expect(page.get_by_text(NOBODY)).to_be_visible()
    fly_and_identify(page, 1, ends="failed.")
    expect(page.locator("[data-live=identify-lines]")).to_contain_text("assumed: nobody stated the plant of this rig")
    expect(page.locator(".file", has_text="recordings")).to_contain_text("plant assumed")
    expect(page.get_by_text("When this campaign was flown, nobody had stated the plant")).to_be_visible()

    page.get_by_text("State the plant", exact=True).click()
    state(page, name="heavy", mass_g="20", diameter_mm="17", travel_mm="12", x_max_mm="16")
    press(page, "State this plant")
    expect(page.get_by_text("Stated by")).to_be_visible()
    fly_and_identify(page, 2, ends="done")

    (made,) = (rig.folder / "data" / "campaigns").glob("*/model.json")
    parameters = json.loads(made.read_text())["parameters"]
    # 4 standard errors: one good campaign in 8000 would fail for one of the two.
    for name, true in TRUTH.items():
        estimate = parameters[name]
        assert abs(estimate["value"] - true) < 4 * estimate["std"], (name, estimate)
        assert "assumed" not in estimate["method"]
    expect(page.locator(".results").get_by_text("K_c").first).not_to_contain_text("(plant assumed)")
    rig.gateway.end()
    rig.start_gateway()
    page.reload()
    expect(page.get_by_text("Stated by")).to_be_visible()
    expect(page.locator("[data-part=plant]")).to_contain_text("heavy")
