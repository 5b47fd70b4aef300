"""A log that is replayed on the page: its timeline with marks, pause, seek, speed, and its end, in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway import hmi_peers
from tests.harness.gateway.bus_peers import played_gateway
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import frame, hmi

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-replay"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
START_NS = 1_700_000_000_000_000_000
SECONDS = 60
STATE = '[data-live="replay-state"]'
AT = '[data-live="replay-at"]'


def write(path: Path, rig: str) -> None:
    """A minute of flight; the position tells the time: x = t * 0.05 mm."""
    writer = LogWriter(path)
    for tick in range(SECONDS * 50):
        at_ns, t_s = START_NS + tick * 20_000_000, tick * 0.02
        state = pb.State(tick=tick, session=1, host_time_ns=at_ns, t_s=t_s, x_m=t_s * 5e-5, x_ref_m=1e-3, i_c_a=0.6)
        state.u_c_v, state.mode = 2.1, pb.MODE_CLOSED_LOOP
        writer.write(f"board51/{rig}/state", state.SerializeToString(), at_ns)
        if tick % 250 == 0:
            parameters = pb.Parameters(session=1, sample_time_s=0.02, x_ref_max_m=4e-3, host_time_ns=at_ns)
            writer.write(f"board51/{rig}/parameters", parameters.SerializeToString(), at_ns)
        if tick in (1000, 2000):
            severity = "fault" if tick == 1000 else "info"
            event = pb.Event(name="over-current", severity=severity, source="board", host_time_ns=at_ns)
            writer.write(f"board51/{rig}/event", event.SerializeToString(), at_ns)
    writer.close()


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    folder = tmp_path_factory.mktemp("replay")
    (folder / "logs").mkdir()
    write(folder / "logs" / "flight.mcap", "rig")
    with played_gateway() as gateway, hmi(folder, gateway.endpoint) as (port, _):
        yield port


@pytest.fixture
def page(browser: Browser, port: int) -> Iterator[Page]:
    with open_tab(browser) as page:
        page.goto(f"http://127.0.0.1:{port}/logs")
        yield page
        visitor = hmi_peers.Page(port)
        visitor.open()
        visitor.post("/api/*/job", {"kind": "replay", "act": "stop"})
        with visitor.live("/live-replay") as live:
            wait_for(lambda: not frame(live)["jobs"].get("replay", {}).get("running"), "its end")


def replay(page: Page) -> None:
    """Start it, and wait for its marks."""
    page.locator(".log", has_text="flight").get_by_role("button", name="Replay").click()
    page.wait_for_url("**/replay/rig")
    expect(page.locator(STATE)).to_have_text("▶ playing")
    expect(page.locator(".mark")).to_have_count(2)


def seek(page: Page, share: float) -> None:
    """Click on the line."""
    box = page.locator(".marks").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + share * box["width"], box["y"] + 4)


def test_the_list_says_how_long_a_log_is_and_of_which_rig(page: Page) -> None:
    expect(page.locator(".log .at")).to_contain_text("rig, 0:59 min")


def test_a_replay_pauses_goes_where_it_is_told_and_says_when_it_ends(page: Page) -> None:
    replay(page)
    assert [mark.get_attribute("data-state") for mark in page.locator(".mark").all()] == ["fault", "info"]

    page.get_by_role("button", name="Pause replay").click()
    expect(page.locator(STATE)).to_have_text("❚❚ paused")
    seek(page, 0.5)
    expect(page.locator(AT)).to_have_text("0:30 of 0:59")
    expect(page.locator('[data-live="x"]').first).to_have_text(re.compile(r"1\.50\d"))
    expect(page.locator('[data-live="link"]')).to_have_text("❚❚ paused")  # not lost: it stands still
    assert page.locator("body").get_attribute("data-live") == "yes"
    expect(page.locator(".ball-drawing .ball")).to_be_visible()  # its travel was said before

    page.locator(".mark").first.click()  # half a second before it
    expect(page.locator(AT)).to_have_text("0:19 of 0:59")
    page.locator("[data-speed='5']").click()
    expect(page.locator("[data-speed='5']")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("button", name="Play on").click()
    expect(page.locator(".events .entry")).to_have_count(1)

    seek(page, 0.98)
    expect(page.locator(STATE)).to_have_text("■ ended")
    expect(page.locator(AT)).to_have_text("0:59 of 0:59")
    assert page.locator(".alarm").count() == 0, "an end is no alarm"

    page.get_by_role("slider", name="Position in the recording").press("Home")
    expect(page.locator(STATE)).to_have_text("▶ playing")


def test_the_end_of_a_replay_is_told_apart_from_a_rig_that_is_silent(page: Page) -> None:
    replay(page)

    page.reload()  # a page that is opened later has the button, too
    page.get_by_role("button", name="End replay").click()

    expect(page.locator(STATE)).to_contain_text("over")
    expect(page.locator("[data-speed='5']")).to_be_disabled()


@pytest.mark.parametrize("order", ["dance", "seek", "seek 1\nspeed 2", "speed 1e3", "seek -1"])
def test_what_is_no_order_is_refused(port: int, order: str) -> None:
    visitor = hmi_peers.Page(port)
    visitor.open()

    answer = visitor.post("/api/*/job", {"kind": "replay", "act": "order", "order": order}).json()

    assert (answer["accepted"], answer["reason"]) == (False, "malformed")


def test_an_order_without_a_replay_is_refused(port: int) -> None:
    visitor = hmi_peers.Page(port)
    visitor.open()

    answer = visitor.post("/api/*/job", {"kind": "replay", "act": "order", "order": "pause"}).json()

    assert answer["reason"] == "not-running"
