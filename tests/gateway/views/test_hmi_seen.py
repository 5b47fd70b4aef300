"""Tests of everything that a person sees and reaches on the pages, in a real browser; the gateway behind is played."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page, expect

from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.design_files import campaign, designed
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import hmi
from tests.harness.gateway.npm import installed
from tests.harness.gateway.page_scripts import CONTRASTS, PLACES, STRONG_COLOURS
from tests.harness.gateway.seen_site import Site, raise_alarms, stop_turns_the_coil_off

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-seen"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
STOP_MESSAGE = '[data-live="stop-said"]'
REPORT = "<!doctype html><body style='margin:0'><h1>air-gap-offset</h1><p style='height:2000px'>long</p>"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("seen")
    report = folder / "diagnosis" / "one"
    report.mkdir(parents=True)
    (report / "report.html").write_text(REPORT)
    (folder / "logs").mkdir()
    (folder / "logs" / "a.mcap").write_bytes(b"not a log")
    designed(campaign(folder / "data"))
    with (
        played_gateway() as gateway,
        hmi(folder, gateway.endpoint, "--reports", str(folder / "diagnosis")) as (port, _),
    ):
        yield Site(gateway, port)


@pytest.fixture
def page(browser: Browser, site: Site) -> Iterator[Page]:
    """A tab; no script in it may fail, and no policy be broken."""
    site.gateway.commands.clear()
    site.mode = {"mode": pb.MODE_CLOSED_LOOP}
    broken: list[str] = []
    with open_tab(browser) as page:
        page.on("console", lambda entry: broken.append(entry.text) if "Content Security" in entry.text else None)
        yield page
    assert broken == []


@pytest.mark.parametrize("path", ["/", "/logs", "/replay/", "/replay/rig", "/report/0/one/report.html", "/rig/rig"])
def test_every_page_has_stop_for_its_rig_or_for_all(page: Page, site: Site, path: str) -> None:
    """By the key, and again by the button."""
    stop_turns_the_coil_off(site)
    expected = {"rig"} if path == "/rig/rig" else {"rig", "two"}
    with site.live():
        page.goto(f"{site.url}{path}")
        wait_for(lambda: page.evaluate("document.querySelector('button.stop') !== null"), "STOP")
        if "report" in path:
            page.frame_locator("iframe").get_by_text("long").click()  # the focus is in the report, which has no script
            wait_for(
                lambda: page.evaluate("document.activeElement.tagName !== 'IFRAME'"), "the page has the focus again"
            )

        page.keyboard.press("Escape")
        wait_for(lambda: set(site.stopped()) == expected, f"STOP of {expected}, not {site.stopped()}")
        expect(page.locator(STOP_MESSAGE)).to_contain_text("STOP accepted")
        expect(page.locator(STOP_MESSAGE)).to_contain_text("coil off (sample of tick")

        site.gateway.commands.clear()
        page.click("button.stop")
        wait_for(lambda: set(site.stopped()) == expected, f"STOP of {expected}, not {site.stopped()}")


def test_a_page_says_what_its_stop_stops(page: Page, site: Site) -> None:
    for path, what in (("/", "all rigs"), ("/rig/rig", "rig"), ("/replay/rig", "all live rigs")):
        page.goto(f"{site.url}{path}")
        assert " ".join(page.locator("button.stop").inner_text().split()) == f"STOP {what}"
        assert "STOP switches off the coil" in page.locator(".messages .hint").inner_text()


def test_one_rig_is_stopped_from_the_overview_by_its_own_button(page: Page, site: Site) -> None:
    with site.live():
        page.goto(site.url)
        page.get_by_role("button", name="STOP two").click()

        wait_for(site.stopped, "STOP")

    assert site.stopped() == ["two"]


def test_esc_closes_an_open_panel_first_says_so_and_stops_then(page: Page, site: Site) -> None:
    with site.live():
        page.goto(f"{site.url}/logs")
        page.get_by_role("button", name="Summary").click()
        expect(page.locator("dialog.summary")).to_be_visible()

        page.keyboard.press("Escape")

        expect(page.locator("dialog.summary")).to_be_hidden()
        expect(page.locator(".toast")).to_contain_text("Nothing was stopped. Press Esc again for STOP")
        assert site.stopped() == []
        page.get_by_role("button", name="Summary").click()
        page.click("button.stop")  # within reach while it is open
        wait_for(lambda: set(site.stopped()) == {"rig", "two"}, "STOP")
        site.gateway.commands.clear()
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")
        wait_for(lambda: set(site.stopped()) == {"rig", "two"}, "STOP by the second Esc")


def test_the_banner_waits_for_a_sample_and_believes_no_answer(page: Page, site: Site) -> None:
    """Accepted, and the coil stays on."""
    site.gateway.answer = lambda _, command: pb.CommandReply(id=command.id, accepted=True, tick=10**9)
    with site.live():
        page.goto(f"{site.url}/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        page.keyboard.press("Escape")
        expect(page.locator(STOP_MESSAGE)).to_contain_text("accepted at tick 1000000000, waiting for its sample")

        site.gateway.answer = lambda _, command: pb.CommandReply(id=command.id, accepted=True, tick=1)
        page.keyboard.press("Escape")

        expect(page.locator(STOP_MESSAGE)).to_contain_text("COIL ON: its samples show mode closed loop")
        expect(page.locator(STOP_MESSAGE)).to_have_attribute("data-state", "bad")
    expect(page.locator(STOP_MESSAGE)).to_contain_text("it is unknown whether the coil is")


def test_a_coil_that_the_board_cannot_switch_off_is_never_called_off(page: Page, site: Site) -> None:
    """Idle by its samples, STOP accepted, and the board has a fault that it cannot end."""
    idle = {"mode": pb.MODE_IDLE, "flags": Flag.FAULT, "u_c_v": 2.0}
    site.gateway.answer = lambda _, command: pb.CommandReply(id=command.id, accepted=True, tick=1)
    with ticking(site.gateway, "rig", "two", values=lambda _: idle):
        page.goto(f"{site.url}/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        site.gateway.send("event", pb.Event(name="output-fault", severity="fault", text="cut", session=1), "rig")
        expect(page.locator('[data-live="mode"]')).to_have_text("idle \u00b7 COIL MAY BE ON")

        page.keyboard.press("Escape")

        expect(page.locator(STOP_MESSAGE)).to_contain_text("THE COIL MAY BE ON: cut its supply")
        expect(page.locator(STOP_MESSAGE)).to_have_attribute("data-state", "bad")
    with ticking(site.gateway, "rig", "two"):  # no fault any more, for the tests behind this one
        expect(page.locator('[data-live="mode"]')).not_to_contain_text("MAY BE ON")


@pytest.mark.parametrize("when", ["opened while nothing comes", "the samples end"])
def test_in_a_lost_state_everything_is_marked_as_last_known(page: Page, site: Site, when: str) -> None:
    with site.live():
        page.goto(f"{site.url}/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        wait_for(lambda: page.evaluate(STRONG_COLOURS) > 50, "traces in full colour")
    if when.startswith("opened"):
        page.reload()
    page.wait_for_selector("body[data-live=no]")

    expect(page.locator('[data-live="lost"]')).to_contain_text("NO DATA for")
    expect(page.locator('[data-live="mode"]')).to_have_text("last known: closed loop \u00b7 coil on")
    expect(page.locator('[data-live="twin"]')).to_contain_text("last known: ")
    expect(page.locator('[data-live="log"]')).not_to_have_text("\u25cf log writing")
    button = page.locator('[data-mode="closed loop"]')
    expect(button).to_have_attribute("aria-pressed", "false")
    expect(button).to_have_attribute("data-last", "yes")
    expect(page.locator(".plot-x")).to_have_attribute("aria-label", re.compile(r"up to \d\d:\d\d:\d\d$"))
    assert page.evaluate(STRONG_COLOURS) == 0, "what is old is veiled"
    expect(page.locator('[data-live="log"]')).to_contain_text("last known: ")  # no status for seconds either


def test_a_board_that_does_not_answer_is_told_in_the_bar(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/rig/rig")
    site.gateway.send("status", pb.Status(link="streaming", to_board="unanswered", log_state="writing"))

    expect(page.locator('[data-live="to-board"]')).to_contain_text("BOARD DOES NOT ANSWER")

    cut = """() => [...document.querySelectorAll('.chip')].filter((chip) => {
        const box = chip.getBoundingClientRect(), row = chip.parentElement.getBoundingClientRect();
        return chip.scrollWidth > chip.clientWidth || box.right > row.right || box.bottom > row.bottom;
    }).map((chip) => chip.dataset.live)"""
    may_be_cut = {"runs", "twin", "log"}  # what is urgent is whole
    assert set(page.evaluate(cut)) <= may_be_cut
    assert page.locator(".bar").bounding_box()["height"] == 56  # type: ignore[index]  # it is visible
    page.set_viewport_size({"width": 900, "height": 800})
    assert set(page.evaluate(cut)) <= may_be_cut


def test_the_cause_that_the_twin_names_is_on_the_page_as_long_as_it_is_named(page: Page, site: Site) -> None:
    page.goto(f"{site.url}/rig/rig")
    named = page.locator('[data-live="named"]')
    sentence = "the rig behaves as if dry friction of 5 mN holds and brakes the ball"
    diagnosis = pb.TwinDiagnosis(
        cause="coulomb-friction", sentence=sentence, probability=0.9, for_s=40.2, since_ns=1_700_000_000_000_000_000
    )

    def shows(sent: pb.TwinDiagnosis) -> str:
        site.gateway.send("twin/diagnosis", sent)  # again and again, as the twin does
        return named.inner_text()

    with site.live():
        wait_for(lambda: sentence in shows(diagnosis), "name")
        words = rf"For 40 s of flight {sentence} \(0\.9\), since 2023-11-1\d \d\d:\d\d:\d\d\. A diagnosis decides\."
        assert re.fullmatch(words, shows(diagnosis))

        wait_for(lambda: shows(pb.TwinDiagnosis()) == "", "end of the name")


def test_what_became_of_a_stop_is_told_for_each_rig(page: Page, site: Site) -> None:
    """The coil of `two` is off, as far as samples say, and nobody is sent to switch it off by hand."""

    def answer(key: str, command: pb.Command) -> pb.CommandReply:
        if "/two/" in key:
            return pb.CommandReply(id=command.id, accepted=True, tick=1)
        return pb.CommandReply(id=command.id, refused_by="link", reason="timed-out", text="No answer.")

    site.gateway.answer = answer
    site.mode = {"mode": pb.MODE_IDLE}
    with site.live():
        page.goto(site.url)
        page.wait_for_selector(".board-card >> nth=1")
        page.keyboard.press("Escape")
        banner = page.locator(STOP_MESSAGE)
        expect(banner).to_contain_text("STOP REFUSED for rig, accepted for the others")
        expect(banner).to_contain_text("two: coil off")
        expect(banner).to_contain_text("But the coil is off (sample")
        assert "by hand" not in banner.inner_text()
    expect(page.locator(STOP_MESSAGE)).to_contain_text("Switch rig off by hand")
    assert "Switch two" not in page.locator(STOP_MESSAGE).inner_text()


def test_nothing_that_comes_moves_the_controls(page: Page, site: Site) -> None:
    """Alarms, flags, words across the page, marked chips, refusals."""
    site.gateway.answer = lambda _, command: pb.CommandReply(refused_by="gateway", reason="slew", text="Too far. " * 20)
    with site.live():
        page.goto(f"{site.url}/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        expect(page.locator('[data-live="reference-range"]')).to_contain_text("mm")
        before = page.evaluate(PLACES)
        assert len(before) >= 6

        raise_alarms(site, 5)
        site.mode = {"mode": pb.MODE_OPEN_LOOP, "flags": 0xFC}
        wait_for(lambda: page.locator(".alarm").count() > 5, "alarms, the board's fault among them")
        page.click('[data-mode="idle"]')
        expect(page.locator(".toast[data-state=bad]")).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator(STOP_MESSAGE)).to_contain_text("REFUSED")
        assert page.evaluate(PLACES) == before
    page.wait_for_selector("body[data-live=no]")
    expect(page.locator('[data-live="log"]')).to_contain_text("last known: ")

    assert page.evaluate(PLACES) == before


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script of axe-core."""
    folder = installed(Path(__file__).parent / "axe", tmp_path_factory.mktemp("axe"))
    return (folder / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


def test_axe_finds_nothing_serious_on_any_page(page: Page, site: Site, axe: str) -> None:
    violations: list[object] = []
    with site.live():
        raise_alarms(site, 2)
        for path in ("/", "/rig/rig", "/model/rig", "/logs", "/replay/", "/api/v1/"):
            page.emulate_media(color_scheme="light")
            page.goto(site.url + path)
            page.wait_for_load_state("networkidle" if path == "/logs" else "load")
            page.evaluate(axe)
            result = page.evaluate("axe.run()")
            page.emulate_media(color_scheme="dark")
            dark = page.evaluate("axe.run({runOnly: ['color-contrast']})")  # nothing else depends on it
            violations += [
                (path, issue["id"], issue["help"], [node["html"][:150] for node in issue["nodes"][:3]])
                for issue in (*result["violations"], *dark["violations"])
                if issue["impact"] in ("serious", "critical")
            ]
            assert len(result["passes"]) > 10, "it has looked"
            assert dark["passes"], "it has looked"

        page.evaluate("document.body.append(document.createElement('input'))")
        page.evaluate("document.body.style.cssText = 'color: #444 !important'")
        nameless = page.evaluate("axe.run()")["violations"]

    assert violations == []
    assert {"label", "color-contrast"} <= {issue["id"] for issue in nameless}, "it would find both"


def test_dark_is_kept_once_it_was_chosen(page: Page, site: Site) -> None:
    def theme() -> object:
        return page.evaluate("document.documentElement.dataset.theme")

    page.emulate_media(color_scheme="light")
    page.goto(f"{site.url}/")
    assert theme() == "light"

    page.get_by_role("button", name="Light / dark").click()
    page.goto(f"{site.url}/logs")

    assert theme() == "dark"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_can_be_read(page: Page, site: Site, scheme: Literal["light", "dark"]) -> None:
    """4.5 : 1, WCAG 2 AA."""
    page.emulate_media(color_scheme=scheme)
    site.gateway.answer = lambda _, command: pb.CommandReply(refused_by="gateway", reason="slew", text="Too far.")
    low: list[object] = []

    def look(where: str) -> None:
        contrasts = page.evaluate(CONTRASTS)
        assert len(contrasts) > 5, where
        low.extend([where, *contrast] for contrast in contrasts if contrast[0] < 4.5)

    with site.live():
        raise_alarms(site, 2)
        page.goto(f"{site.url}/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        expect(page.locator(".alarm").first).to_be_visible()
        page.click('[data-mode="idle"]')
        expect(page.locator(".toast[data-state=bad] button")).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator(STOP_MESSAGE)).to_contain_text("REFUSED")
        look("refused")
        stop_turns_the_coil_off(site)
        page.keyboard.press("Escape")
        page.click('[data-mode="idle"]')
        expect(page.locator(".toast[data-state=good]")).to_be_visible()
        expect(page.locator(STOP_MESSAGE)).to_have_attribute("data-state", "good")
        look("accepted")
        for path in ("/", "/model/rig", "/logs", "/replay/", "/replay/rig", "/api/v1/"):
            page.goto(f"{site.url}{path}")
            expect(page.locator(".messages .hint")).to_be_visible()
            if path == "/":
                expect(page.locator(".board-card").first).to_be_visible()
            look(path)
    page.goto(f"{site.url}/rig/rig")
    expect(page.locator('[data-live="log"]')).to_contain_text("last known: ")
    look("lost")

    assert low == []


def test_a_link_says_the_span_of_the_plots_and_the_pointer_reads_time_and_values(page: Page, site: Site) -> None:
    with site.live():
        page.goto(f"{site.url}/rig/rig#span=60")
        expect(page.locator('[data-span="60"]')).to_have_attribute("aria-pressed", "true")
        expect(page.locator('[data-live="plots-zone"]')).to_have_text(re.compile(r"Times: \S+\."))
        plot = page.locator(".plot-x .u-over")
        legend = page.locator(".plot-x .u-legend .u-value")

        def read() -> bool:
            box = plot.bounding_box()
            assert box is not None
            page.mouse.move(box["x"] + box["width"] - 4, box["y"] + 20)
            page.mouse.move(box["x"] + box["width"] - 3, box["y"] + 20)
            return re.fullmatch(r"\d\d:\d\d:\d\d[.,]\d\d", legend.first.inner_text()) is not None

        wait_for(read, "the time under the pointer")
        page.locator('[data-span="5"]').click()

    assert page.url.endswith("#span=5")
