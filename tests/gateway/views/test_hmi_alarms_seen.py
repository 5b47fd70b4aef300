"""The alarms of a rig as a person sees and handles them, in a real browser; the gateway is played."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.hmi_peers import hmi

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("hmi-seen"),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
FLAGS = {"flags": 0}  # of the samples
DIVERGENCE = pb.Divergence(
    sync="in-step",
    i_c_a=pb.SignalDivergence(error=0.15, normalised=6.0, rolling_rmse=0.15, rolling_mean=0.15),
)


def answer(gateway: PlayedGateway, key: str, command: pb.Command) -> pb.CommandReply:
    """Accept a command as the gateway does: it is recorded for every view."""
    reply = pb.CommandReply(id=command.id, accepted=True, tick=7)
    record = pb.CommandRecord(command=command, reply=reply, received_ns=time.time_ns())
    gateway.send("command/record", record, key.split("/")[1])
    return reply


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PlayedGateway, str]]:
    folder = tmp_path_factory.mktemp("alarms")
    with (
        played_gateway() as gateway,
        hmi(folder, gateway.endpoint) as (port, _),
        ticking(gateway, "rig", values=lambda _: FLAGS),
    ):
        gateway.answer = lambda key, command: answer(gateway, key, command)
        yield gateway, f"http://127.0.0.1:{port}"


@pytest.fixture
def page(browser: Browser, served: tuple[PlayedGateway, str]) -> Iterator[Page]:
    gateway, url = served
    with open_tab(browser, width=1440, url=url) as page:
        page.goto("/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        gateway.commands.clear()
        yield page


def raise_alarm(gateway: PlayedGateway, name: str, *, active: bool = True) -> None:
    gateway.send("twin/alarm", pb.Alarm(name=name, active=active, text="wrong", host_time_ns=time.time_ns()))


def group(page: Page, name: str) -> Locator:
    return page.locator(f"[data-group={name}] .alarm")


def test_alarms_stand_in_groups_and_all_are_acknowledged_by_one_press_each_with_its_name(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    gateway = served[0]
    for name in ("one", "two", "three"):
        raise_alarm(gateway, name)
    raise_alarm(gateway, "two", active=False)
    expect(group(page, "unacknowledged").filter(has_text="one")).to_be_visible()
    expect(group(page, "returned").filter(has_text="two")).to_be_visible()
    page.locator(".alarm", has_text="three").get_by_role("button", name="Acknowledge").click()
    expect(group(page, "acknowledged").filter(has_text="three")).to_contain_text("acknowledged by")
    gateway.commands.clear()

    page.get_by_role("button", name="Acknowledge all").click()

    expect(group(page, "acknowledged").filter(has_text="one")).to_be_visible()
    expect(group(page, "unacknowledged")).to_have_count(0)
    expect(group(page, "returned")).to_have_count(0)
    sent = [command for _, command in gateway.commands if command.HasField("acknowledge")]
    assert {"one", "two"} <= {command.acknowledge.alarm for command in sent}
    assert all(command.who for command in sent)
    expect(page.get_by_role("button", name="Acknowledge all")).to_be_disabled()


def test_a_shelved_alarm_is_listed_and_counted_apart_and_can_be_brought_back(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    raise_alarm(served[0], "noisy")
    row = page.locator(".alarm", has_text="noisy")
    row.get_by_role("button", name="Shelve").click()
    row.get_by_role("button", name="1 h").click()

    shelved = group(page, "shelved").filter(has_text="noisy")
    expect(shelved).to_contain_text(re.compile(r"shelved by \S+ until \d\d:\d\d"))
    expect(page.locator('[data-live="alarm-count"]')).to_contain_text("1 shelved")
    assert [command.acknowledge.shelve_s for _, command in served[0].commands] == [3600.0]
    page.goto("/")
    expect(page.locator(".board-alarms")).to_contain_text("1 shelved")
    page.goto("/rig/rig")
    shelved.get_by_role("button", name="Bring back").click()

    expect(group(page, "acknowledged").filter(has_text="noisy")).to_be_visible()
    expect(page.locator('[data-live="alarm-count"]')).not_to_contain_text("shelved")


def test_a_fault_is_shelved_or_acknowledged_with_the_others_by_a_second_press_only(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    gateway = served[0]
    FLAGS["flags"] = int(Flag.FAULT)
    try:
        fault = page.locator(".alarm[data-state=fault]").first
        fault.get_by_role("button", name="Shelve").click()
        fault.get_by_role("button", name="8 h").click()
        again = page.get_by_role("button", name="A FAULT: again")
        expect(again).to_be_visible()
        page.get_by_role("button", name="Acknowledge all").click()
        every = page.get_by_role("button", name="A FAULT is among them")
        expect(every).to_be_visible()
        assert gateway.commands == []

        page.mouse.click(5, 700)  # not a double click
        again.click()
        expect(group(page, "shelved").filter(has_text="FAULT")).to_be_visible()
        page.goto("/")
        expect(page.locator(".board-card[data-state=bad]")).to_have_count(1)  # all rigs are seen by others, too
    finally:
        FLAGS["flags"] = 0


def test_the_journal_says_what_became_of_an_alarm_and_by_whom_and_is_sifted(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    raise_alarm(served[0], "written")
    page.locator(".alarm", has_text="written").get_by_role("button", name="Acknowledge").click()
    rows = page.locator('[data-live="journal"] .entry')
    expect(rows.first).to_contain_text("acknowledged by")  # what the gateway sends next may overtake it otherwise
    raise_alarm(served[0], "written", active=False)
    raise_alarm(served[0], "other")
    expect(rows.first).to_contain_text("other")
    expect(rows.first.locator(".at")).to_have_text(re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d"))

    page.get_by_label("Filter the journal").fill("WRITTEN")

    entries = page.locator('[data-live="journal"] .entry:visible .text')
    expect(entries).to_have_text(["went", re.compile("acknowledged by "), "came: wrong"])


def test_an_alarm_of_the_twin_reads_in_numbers_as_on_the_card_of_the_model_and_its_button_stays(
    page: Page, served: tuple[PlayedGateway, str]
) -> None:
    gateway = served[0]
    raise_alarm(gateway, "divergence-i_c")
    row = page.locator(".alarm", has_text="divergence-i_c")
    button = row.get_by_role("button", name="Acknowledge").element_handle()
    assert button is not None
    for current in (0.15, 0.25):
        DIVERGENCE.i_c_a.rolling_mean = DIVERGENCE.i_c_a.rolling_rmse = current

        def is_displayed(text: str = f"{current} A") -> bool:
            gateway.send("twin/divergence", DIVERGENCE)
            return text in row.inner_text()

        for _ in range(200):
            if is_displayed():
                break
        else:
            pytest.fail(row.inner_text())
    expect(page.locator('[data-live="wrong"]').first).to_contain_text("0.25 A")

    assert button.evaluate("(e) => e.isConnected")
