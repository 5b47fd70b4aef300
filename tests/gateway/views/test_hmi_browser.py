"""The web page in a real browser, on an emulated rig behind a real gateway: what an operator sees and does."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.gateway_peers import Bus, client, wait_for
from tests.harness.gateway.rig_peers import Rig, emulated_rig

pytestmark = [
    pytest.mark.xdist_group("hmi-browser"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
NOTE_THE_LOSS = """() => {
    window.lostAt = 0;
    const look = () => { if (document.body.dataset.live === 'no' && !window.lostAt) window.lostAt = Date.now(); };
    new MutationObserver(look).observe(document.body, { attributes: true });
}"""
NOTE_THE_PRESS = """() => {
    for (const kind of ['keydown', 'pointerdown'])
        window.addEventListener(kind, () => { window.pressedAt = Date.now(); }, { capture: true });
}"""
INK_OF_A_PLOT = """() => {
    const canvas = document.querySelector('.plot-x canvas');
    const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    return pixels.filter((value, n) => n % 4 === 3 && value > 0).length;
}"""
PICTURE = "document.querySelector('.plot-x canvas').toDataURL()"
NOTE_CHANGES = """() => {
    window.changes = 0;
    const options = { childList: true, characterData: true, subtree: true };
    window.observer?.disconnect();
    window.observer = new MutationObserver(() => { window.changes += 1; });
    window.observer.observe(document.querySelector('[data-live=x]'), options);
}"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("hmi-rig")
    with emulated_rig(folder) as rig:
        yield rig


@pytest.fixture
def bus(rig: Rig) -> Iterator[Bus]:
    with client(rig.endpoint) as bus:
        wait_for(lambda: bus.states(), "a sample")
        yield bus


@pytest.fixture(scope="module")
def operators_tab(browser: Browser) -> Iterator[Page]:
    """Provide one tab for all tests, like an operator's; no script in it may fail."""
    with open_tab(browser) as page:
        yield page


@pytest.fixture
def page(operators_tab: Page, rig: Rig) -> Page:
    """The rig's page, live; the board is idle."""
    page = operators_tab
    if page.url != f"{rig.url}/rig/rig":
        page.goto(f"{rig.url}/rig/rig")
    page.wait_for_selector("body[data-live=yes]")
    page.keyboard.press("Escape")  # STOP
    # Answered, not only idle: a STOP that is still on its way would end what the test does next.
    expect(page.locator('[data-live="stop-said"]')).to_contain_text("STOP accepted")
    expect(page.locator('[data-live="mode"]')).to_contain_text("idle")
    return page


def live(page: Page, name: str) -> str:
    return page.locator(f'[data-live="{name}"]').first.inner_text()


def millimetres(page: Page, name: str) -> float:
    text = live(page, name)
    return float(text) if text.replace(".", "").replace("-", "").isdigit() else float("nan")


def flying(page: Page, bus: Bus) -> None:
    """The ball is held."""
    page.click('[data-mode="closed loop"]')
    wait_for(lambda: bus.states()[-1].mode == pb.MODE_CLOSED_LOOP and bus.states()[-1].x_m > 1e-3, "flight")


def set_reference(page: Page, bus: Bus, mm: float) -> None:
    field = page.locator('input[data-number="reference"], [data-number="reference"] input').first
    field.fill(f"{mm:g}")
    field.press("Enter")
    wait_for(lambda: abs(bus.states()[-1].x_ref_m - mm * 1e-3) < 2e-6, f"reference of {mm} mm")


def test_an_operator_flies_the_ball_and_sees_it(page: Page, bus: Bus) -> None:
    flying(page, bus)
    set_reference(page, bus, 2.2)

    wait_for(lambda: abs(millimetres(page, "x") - 2.2) < 0.1, "2.2 mm on the page")
    expect(page.locator('[data-mode="closed loop"]')).to_have_attribute("aria-pressed", "true")
    assert "closed loop" in live(page, "mode")
    assert "LIVE" in live(page, "link")
    expect(page.locator('[data-live="commands"]')).to_contain_text("reference 2.200 mm")
    assert page.evaluate(INK_OF_A_PLOT) > 1000, "the plot is not empty"


@pytest.mark.slow
def test_values_move_thirty_times_a_second(page: Page) -> None:
    def changes_in_a_second() -> int:
        page.evaluate(NOTE_CHANGES)
        page.wait_for_timeout(1000)  # what is measured is a rate
        return int(page.evaluate("window.changes"))

    wait_for(lambda: changes_in_a_second() > 10, "10 changes in a second, also on a machine that does other work")


@pytest.mark.parametrize("how", ["key, page scrolled and a field focused", "button"])
def test_stop_takes_the_current_off_the_coil_at_once(page: Page, bus: Bus, how: str) -> None:
    flying(page, bus)
    if "scrolled" in how:
        page.locator('[data-number="reference"]').first.click()
        page.evaluate("window.scrollTo(0, document.body.scrollHeight)")

    page.evaluate(NOTE_THE_PRESS)  # the driver itself takes its time until it presses a button
    if how == "button":
        page.click("button.stop")
    else:
        page.keyboard.press("Escape")
    wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")

    pressed_ns = int(page.evaluate("window.pressedAt")) * 1_000_000
    first = next(s for s in bus.states() if s.host_time_ns > pressed_ns and s.mode == pb.MODE_IDLE)
    # How fast: tests/bench/reactions.py.
    assert first.u_c_v < 0.01
    expect(page.locator('[data-live="stop-said"]')).to_contain_text("STOP accepted")
    page.evaluate("window.scrollTo(0, 0)")


@pytest.mark.slow
def test_a_refusal_says_who_refused_and_why(page: Page, bus: Bus) -> None:
    page.get_by_text("input u_c", exact=True).click()
    page.get_by_text("Start excitation").click()

    # By whom: just after a change of mode the gateway does not know it yet, and leaves the question to the board.
    words = re.compile(r"excitation .* around .* V.*: Refused by (gateway|board) \(wrong-mode\): .*mode")
    expect(page.locator(".toast[data-state=bad]").last).to_contain_text(words)


@pytest.mark.slow
def test_gains_are_shown_before_they_are_sent(page: Page, bus: Bus) -> None:
    wait_for(lambda: bus.messages["rig/parameters"], "parameters")
    parameters = bus.messages["rig/parameters"][-1]
    point = {"i_0_a": parameters.i_0_a, "x_0_m": parameters.x_0_m, "u_0_v": parameters.u_0_v}
    gains = [*list(parameters.gains)[:3], 1.01 * parameters.gains[3]]
    file = json.dumps({"law": "lqi", "gains": gains, "operating_point": point, "sample_time_s": 0.002}).encode()

    page.set_input_files("input[type=file]", {"name": "g.json", "mimeType": "application/json", "buffer": file})
    expect(page.locator(".preview")).to_contain_text("Nothing is sent yet")
    assert not [r for r in bus.messages["rig/command/record"] if r.command.HasField("set_gains")]
    page.get_by_text("Send these gains to the board").click()

    records = bus.messages["rig/command/record"]
    wait_for(lambda: records and records[-1].command.HasField("set_gains"), "the command")
    record = records[-1]
    assert list(record.command.set_gains.gains) == pytest.approx(gains)
    assert record.reply.accepted, record.reply.text
    page.set_input_files("input[type=file]", {"name": "x.json", "mimeType": "application/json", "buffer": b"{"})
    expect(page.locator(".preview")).to_contain_text("neither JSON nor TOML")


@pytest.mark.slow
def test_a_mark_is_in_the_log(page: Page, bus: Bus) -> None:
    page.get_by_label("remark").fill("ball changed")
    page.get_by_text("Mark now").click()

    assert "ball changed" in bus.await_event("mark").text


@pytest.mark.slow
def test_a_recording_is_started_stopped_and_replayed_apart_from_the_live_rig(page: Page, rig: Rig, bus: Bus) -> None:
    page.get_by_role("button", name="Start", exact=True).click()
    wait_for(lambda: list((rig.folder / "data" / "recordings").glob("*.mcap")), "the recording")
    bus.await_states(500)
    page.get_by_role("button", name="Stop recording").click()
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_visible()

    page.goto(f"{rig.url}/logs")
    row = page.locator(".file", has_text="recordings/").first
    row.get_by_role("button", name="Replay").click()
    page.wait_for_url("**/replay/rig")

    expect(page.locator(".replay-banner")).to_contain_text("NOT LIVE")
    page.wait_for_selector("body[data-live=yes]")
    assert page.locator("button.stop").inner_text().split() == ["STOP", "all", "live", "rigs"]
    assert page.locator("[data-command]").count() == 0, "a recording cannot be commanded"
    assert {key.split("/")[0] for key in bus.messages} == {"rig"}, "nothing of it is on the live bus"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Run quick", "Investigate"])
def test_a_campaign_shows_its_progress_parks_the_ball_when_interrupted_and_goes_on(
    name: str, page: Page, rig: Rig, bus: Bus
) -> None:
    def folders() -> set[str]:
        return {path.name for path in (rig.folder / "data" / "campaigns").glob("rig-*")}

    def interrupt() -> None:
        page.get_by_role("button", name="Interrupt").click()
        expect(page.get_by_text("ended incomplete")).to_be_visible()
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")

    before = folders()
    page.goto(page.url.replace("/rig/", "/model/"))
    page.get_by_role("button", name=name).click()
    wait_for(lambda: bus.states()[-1].x_m > 1e-3, "flight")
    expect(page.locator(".job-lines").first).not_to_be_empty()

    interrupt()

    expect(page.locator(".job-lines").first).to_contain_text("ball parked, coil off")
    (made,) = folders() - before
    page.locator(".file", has=page.locator(f"a[href$='{made}']")).get_by_role("button", name="Continue").click()
    wait_for(lambda: bus.states()[-1].x_m > 1e-3, "flight")
    interrupt()
    assert folders() - before == {made}, "into the same folder"
    expect(page.locator(".file", has=page.locator(f"a[href$='{made}']"))).to_contain_text("continued the campaign")


@pytest.mark.slow
def test_a_plot_can_be_held_zoomed_and_read(page: Page, bus: Bus) -> None:
    def stays() -> bool:
        held, tick = page.evaluate(PICTURE), bus.states()[-1].tick
        wait_for(lambda: bus.states()[-1].tick > tick + 250, "half a second of samples")
        return bool(page.evaluate(PICTURE) == held)

    page.get_by_role("button", name="1 min").click()
    expect(page.locator(".plot-x")).to_have_attribute("aria-label", "Position, 60 seconds up to now")
    page.get_by_role("button", name="Pause").click()
    wait_for(stays, "a picture that stays")  # what was on its way at the press may still be drawn
    held = page.evaluate(PICTURE)
    page.get_by_role("button", name="Go on").click()
    wait_for(lambda: page.evaluate(PICTURE) != held, "a new picture")

    box = page.locator(".plot-x .u-over").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] * 0.9, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y, steps=4)
    page.mouse.up()
    expect(page.get_by_role("button", name="Go on")).to_be_visible()
    expect(page.locator(".plot-x .u-value").nth(1)).to_have_text(re.compile(r"\d\.\d"))
    page.get_by_role("button", name="20 s").click()
    expect(page.get_by_role("button", name="Pause")).to_be_visible()


@pytest.mark.slow
def test_a_lost_board_is_shown_and_comes_back(page: Page, rig: Rig, bus: Bus) -> None:
    page.evaluate(NOTE_THE_LOSS)

    rig.emulator.signal(signal.SIGSTOP)  # its port is there, nothing comes
    try:
        wait_for(lambda: page.evaluate("window.lostAt > 0"), "the loss on the page")
        expect(page.locator('[data-live="lost"]')).to_contain_text("NO DATA for")
        assert "LIVE" not in live(page, "link")
    finally:
        rig.emulator.signal(signal.SIGCONT)

    page.wait_for_selector("body[data-live=yes]")


@pytest.mark.slow
def test_the_page_recovers_when_the_gateway_restarts(page: Page, rig: Rig) -> None:
    page.evaluate("window.mine = true")

    rig.gateway.end()
    page.wait_for_selector("body[data-live=no]")
    expect(page.locator('[data-live="link"]')).to_contain_text("NO GATEWAY")
    rig.gateway = rig.start_gateway()

    page.wait_for_selector("body[data-live=yes]")
    assert page.evaluate("window.mine"), "without being loaded anew"
    page.keyboard.press("Escape")
    expect(page.locator('[data-live="stop-said"]')).to_contain_text("STOP accepted")


@pytest.mark.slow
def test_the_page_says_that_its_server_is_gone_and_recovers(page: Page, rig: Rig) -> None:
    page.evaluate(NOTE_THE_LOSS)

    rig.hmi.kill()
    wait_for(lambda: page.evaluate("window.lostAt > 0"), "the loss on the page")
    expect(page.locator('[data-live="lost"]')).to_contain_text("lost its server")
    page.keyboard.press("Escape")
    expect(page.locator('[data-live="stop-said"]')).to_contain_text("STOP NOT DELIVERED")
    rig.hmi = rig.start_hmi()

    page.wait_for_selector("body[data-live=yes]")
    page.keyboard.press("Escape")
    expect(page.locator('[data-live="stop-said"]')).to_contain_text("STOP accepted")


@pytest.mark.slow
def test_on_a_phone_stop_is_under_the_thumb_and_nothing_sticks_out(browser: Browser, rig: Rig) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(f"{rig.url}/rig/rig")
    page.wait_for_selector("body[data-live=yes]")

    for scroll in ("0", "document.body.scrollHeight"):
        page.evaluate(f"window.scrollTo(0, {scroll})")
        box = page.locator("button.stop").bounding_box()
        assert box is not None
        assert box["y"] > 700
        assert box["y"] + box["height"] <= 844
        assert box["width"] > 340
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    context.close()
