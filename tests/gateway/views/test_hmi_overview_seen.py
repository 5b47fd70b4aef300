"""The overview of one rig and of many, the tabs of a phone, and words at the edge, in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import hmi

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-seen"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PlayedGateway, str]]:
    folder = tmp_path_factory.mktemp("overview")
    with played_gateway() as gateway, hmi(folder, gateway.endpoint) as (port, _), ticking(gateway, "rig"):
        yield gateway, f"http://127.0.0.1:{port}"


@pytest.fixture
def page(browser: Browser, served: tuple[PlayedGateway, str]) -> Iterator[Page]:
    with open_tab(browser, width=1280, height=800, url=served[1]) as page:
        yield page


def test_a_card_has_the_line_of_x_from_before_the_page_the_mode_the_alarms_and_the_model(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    page.goto("/")
    expect(page.locator(".board-card")).to_have_attribute("data-state", "good")  # it flies for a while
    frames: list[str | bytes] = []
    page.on("websocket", lambda line: line.on("framereceived", lambda frame: frames.append(frame)))
    page.goto("/")
    card = page.locator(".board-card")

    expect(card.locator(".board-spark path")).to_have_attribute("d", re.compile("L.*L"))
    expect(card.locator(".board-range")).to_contain_text("3.00 to 3.00 mm")
    expect(card.locator(".board-text")).to_contain_text("closed loop")
    expect(card.locator(".board-alarms")).to_contain_text("no alarms")
    served[0].send("twin/model", pb.TwinModel(name="identified", sha256="0" * 64))
    expect(card.locator(".board-model")).to_have_text("model identified")
    expect(card.locator(".board-model")).to_have_text("model identified")
    assert ["sparks" in str(frame) for frame in frames][:2] == [True, False]


def test_on_a_phone_three_tabs_share_the_page_of_a_rig_and_stop_stays(page: Page) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto("/rig/rig")
    page.wait_for_selector("body[data-live=yes]")
    parts = {"Control": ".modes", "Plots": ".plot-x canvas", "Alarms": '[data-live="journal"]'}

    for tab in ("Alarms", "Plots", "Control"):
        button = page.get_by_role("button", name=re.compile(f"^{tab}"))
        button.click()
        expect(button).to_have_attribute("aria-pressed", "true")
        assert {name: page.locator(part).first.is_visible() for name, part in parts.items()} == {
            name: name == tab for name in parts
        }
        box = page.locator("button.stop").bounding_box()
        assert box is not None
        assert box["y"] + box["height"] > 800
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_words_at_the_edge_are_three_at_most_once_each_and_go_except_those_about_stop(page: Page) -> None:
    page.clock.install()
    page.goto("/rig/rig")
    toast = "import('/static/server.js').then(({ toast }) => {"
    page.evaluate(f"{toast} for (const n of [1, 2, 2, 3, 4, 5]) toast('refused ' + n, 'bad'); }})")
    words = page.locator(".toast > span")
    expect(words).to_have_text(["refused 3", "refused 4", "refused 5"])
    page.evaluate(f"{toast} toast('about STOP', 'note', 'stop'); toast('refused 6', 'bad'); toast('7', 'good'); }})")
    expect(words).to_have_text(["about STOP", "refused 6", "7"])

    page.clock.run_for(16_000)

    expect(words).to_have_text(["about STOP"])
    page.get_by_role("button", name="Close", exact=True).click()
    expect(words).to_have_count(0)


def test_the_alarm_line_has_its_name_in_the_legend_where_it_lies_on_no_line(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    page.goto("/rig/rig")
    name = page.locator(".plot-d .u-legend .alarm-line")
    expect(name).to_have_text("")

    def named() -> bool:
        served[0].send("twin/divergence", pb.Divergence(sync="in-step", nis_mean=2.0, nis_on=2.4512))
        return name.inner_text() == "alarm line, NIS 2.45"

    wait_for(named, "the name")


def test_from_eight_rigs_on_each_has_a_row_and_thirty_fit_one_screen(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    for number in range(2, 31):
        served[0].state(f"rig{number:02}")

    page.goto("/")

    expect(page.locator(".board-card")).to_have_count(30)
    expect(page.locator(".boards")).to_have_attribute("data-size", "compact")
    assert page.evaluate("document.documentElement.scrollHeight") <= 800
    cut = "(stops) => stops.filter((one) => one.scrollWidth > one.clientWidth).length"
    assert page.locator(".stop-one").evaluate_all(cut) == 0
