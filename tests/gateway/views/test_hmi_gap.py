"""Controls and STOP over a network that fails: a real browser, and a network that holds up what it should carry."""

from __future__ import annotations

import uuid
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.chromium import ABSENT, CHROMIUM
from tests.harness.gateway.gateway_peers import Bus, client, wait_for
from tests.harness.gateway.rig_peers import Network, Rig, emulated_rig
from tests.patience import HANG_MS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-browser"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
STOP_MESSAGE = '[data-live="stop-said"]'


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with emulated_rig(tmp_path_factory.mktemp("hmi-gap")) as rig:
        yield rig


@pytest.fixture
def network(rig: Rig) -> Iterator[Network]:
    with Network(rig.port) as network:
        yield network


@pytest.fixture
def bus(rig: Rig) -> Iterator[Bus]:
    with client(rig.endpoint) as bus:
        wait_for(lambda: bus.states(), "a sample")
        bus.command(uuid.uuid4().hex, stop=pb.Stop())
        wait_for(lambda: bus.states() and bus.states()[-1].mode == pb.MODE_IDLE, "idle")
        yield bus


@pytest.fixture
def page(browser: Browser, network: Network, bus: Bus) -> Iterator[Page]:
    """The rig's page behind the network, live; the board is idle."""
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    context.set_default_timeout(HANG_MS)
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{network.port}/rig/rig")
    page.wait_for_selector("body[data-live=yes]")
    page.evaluate("window.mine = true")
    yield page
    context.close()


def mode(bus: Bus, expected: pb.Mode) -> None:
    wait_for(lambda: bus.states()[-1].mode == expected, pb.Mode.Name(expected))


def close_loop(bus: Bus) -> None:
    """Somebody else does."""
    reply = bus.command(uuid.uuid4().hex, set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP))
    assert reply.accepted, reply.text
    mode(bus, pb.MODE_CLOSED_LOOP)


def count_commands(bus: Bus, what: str) -> int:
    """Count the commands of the kind `what` that the page has sent."""
    records = [record for record in bus.messages["rig/command/record"] if record.command.who != "test"]
    return sum(record.command.WhichOneof("what") == what for record in records)


@pytest.mark.parametrize("how", ["nothing passes", "connections end", "connections are dead and nobody says so"])
def test_controls_work_after_a_gap_of_seconds(page: Page, bus: Bus, network: Network, how: str) -> None:
    page.evaluate("fetch('/api/session').then((answer) => answer.text())")  # a connection to be used again
    network.cut()
    if how == "connections end":
        network.reset()
    expect(page.locator('[data-live="lost"]')).to_contain_text("NO DATA for 6 s")
    if "dead" in how:
        network.lose()
    else:
        network.restore()
    page.wait_for_selector("body[data-live=yes]")

    page.click('[data-mode="closed loop"]')

    mode(bus, pb.MODE_CLOSED_LOOP)
    expect(page.locator(".toast[data-state=good]")).to_contain_text("Closed loop: accepted")
    assert page.evaluate("window.mine"), "the page was not loaded anew"


def test_controls_work_after_the_page_s_server_restarted(page: Page, rig: Rig, bus: Bus) -> None:
    rig.hmi.kill()
    expect(page.locator('[data-live="lost"]')).to_contain_text("lost its server")
    page.click('[data-mode="closed loop"]')
    expect(page.locator(".toast[data-state=bad]")).to_contain_text("NOT ANSWERED")
    rig.hmi = rig.start_hmi()
    page.wait_for_selector("body[data-live=yes]")
    wait_for(lambda: page.evaluate("window.mine === undefined"), "the page loaded anew by itself")
    page.wait_for_selector("body[data-live=yes]")

    page.click('[data-mode="closed loop"]')

    mode(bus, pb.MODE_CLOSED_LOOP)


def test_a_press_during_a_gap_is_answered_in_words_and_not_done_later(page: Page, bus: Bus, network: Network) -> None:
    network.cut()
    page.click('[data-mode="closed loop"]')
    expect(page.locator(".toast[data-state=bad]")).to_contain_text("NOT ANSWERED (no answer for 10 s)")
    page.click('[data-mode="open loop"]')
    page.click('[data-mode="open loop"]')
    page.click('[data-mode="open loop"]')
    # A press of the same button while the first is unanswered is no press.
    expect(page.locator(".toast", has_text="NOT ANSWERED")).to_have_count(2)
    network.restore()  # the server gets what the network held up
    page.wait_for_selector("body[data-live=yes]")
    page.get_by_label("remark").fill("after the gap")
    page.get_by_text("Mark now").click()
    wait_for(lambda: count_commands(bus, "mark") == 1, "what was pressed after the gap")

    assert count_commands(bus, "set_mode") == 0


def test_every_stop_goes_out_at_once_beside_those_that_are_not_answered(page: Page, bus: Bus, network: Network) -> None:
    """The first is answered late; in between somebody closes the loop again."""
    close_loop(bus)
    network.hold_answers(b"/api/rig/stop")
    page.keyboard.press("Escape")
    mode(bus, pb.MODE_IDLE)
    close_loop(bus)

    page.keyboard.press("Escape")

    mode(bus, pb.MODE_IDLE)
    for n in range(3, 9):  # more than a browser has connections
        page.keyboard.press("Escape")
        wait_for(lambda n=n: count_commands(bus, "stop") == n, f"STOP {n}")  # type: ignore[misc]  # mypy sees no type for a lambda default
    network.release_answers()
    expect(page.locator(STOP_MESSAGE)).to_contain_text("STOP accepted")
    expect(page.locator(STOP_MESSAGE)).to_contain_text("coil off")


def test_the_banner_never_says_what_samples_contradict(page: Page, bus: Bus, network: Network) -> None:
    close_loop(bus)
    network.hold_answers(b"/api/rig/stop")
    page.keyboard.press("Escape")
    mode(bus, pb.MODE_IDLE)
    expect(page.locator(STOP_MESSAGE)).to_contain_text("coil off")
    close_loop(bus)
    expect(page.locator(STOP_MESSAGE)).to_contain_text("ON AGAIN: closed loop")
    network.release_answers()

    expect(page.locator(STOP_MESSAGE)).to_contain_text("STOP accepted")
    text = page.locator(STOP_MESSAGE).inner_text()

    assert "coil off" not in text
    assert "ON AGAIN: closed loop" in text
    expect(page.locator(STOP_MESSAGE)).to_have_attribute("data-state", "bad")
    page.keyboard.press("Escape")
    expect(page.locator(STOP_MESSAGE)).to_contain_text("coil off (sample of tick")
    expect(page.locator(STOP_MESSAGE)).to_have_attribute("data-state", "good")
    expect(page.locator('[data-live="mode"]')).to_contain_text("idle")


def test_a_stop_that_the_network_held_up_acts_when_it_arrives(page: Page, bus: Bus, network: Network) -> None:
    close_loop(bus)
    network.cut()
    page.keyboard.press("Escape")
    expect(page.locator(STOP_MESSAGE)).to_contain_text("NO ANSWER for 5 s")
    network.restore()

    mode(bus, pb.MODE_IDLE)
    expect(page.locator(STOP_MESSAGE)).to_contain_text("coil off")


def test_an_excitation_around_any_reference_is_ended_by_its_button(page: Page, bus: Bus) -> None:
    close_loop(bus)
    wait_for(lambda: bus.states()[-1].x_m > 1e-3, "flight")
    page.get_by_text("Start excitation").click()
    expect(page.locator(".toast[data-state=good]").last).to_contain_text("for 20 s: accepted")

    page.get_by_text("End it").click()

    wait_for(lambda: count_commands(bus, "excite") == 2, "its end")
    end = bus.messages["rig/command/record"][-1]
    assert (end.command.excite.shape, end.command.excite.on_reference) == (pb.SHAPE_NONE, True)
    assert end.reply.accepted, end.reply.text


def test_what_was_refused_does_not_stand_as_if_in_force(page: Page, bus: Bus) -> None:
    close_loop(bus)
    field, toast = page.locator('[data-number="reference"]'), page.locator(".toast[data-state=bad]")
    expect(page.locator('[data-live="reference-range"]')).to_contain_text(
        "0.3 to 5.199 mm"
    )  # 5.2 mm is between two counts
    in_force = field.input_value()

    field.fill("9")
    field.press("Enter")

    expect(toast).to_contain_text("x_ref = 9 mm is outside the gateway's limits, 0.3 mm .. 5.2 mm")
    expect(field).to_have_value(in_force)
    expect(page.locator('[data-live="reference-now"]')).to_have_text(f"in force: {in_force} mm")
