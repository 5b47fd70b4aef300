"""Tests of the rigs that a page shows and stops, never a recording beside a live rig, and of their reference range."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from playwright.sync_api import Browser, Page, expect

from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway import hmi_peers
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, open_tab
from tests.harness.gateway.gateway_peers import Bus, client, wait_for
from tests.harness.gateway.hmi_peers import Process, frame
from tests.harness.gateway.rig_peers import Rig, emulated_rig

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("hmi-browser")]
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason=ABSENT)
START_NS = 1_700_000_000_000_000_000
SECONDS = 600  # longer than any test


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with emulated_rig(tmp_path_factory.mktemp("hmi-rigs")) as rig:
        for board in ("demo", "rig"):
            write_log(rig.folder / "logs" / f"of-{board}.mcap", board)
        yield rig


@pytest.fixture
def bus(rig: Rig) -> Iterator[Bus]:
    with client(rig.endpoint) as bus:
        wait_for(bus.states, "a sample")
        yield bus


@pytest.fixture
def page(browser: Browser, rig: Rig) -> Iterator[Page]:
    with open_tab(browser) as page:
        yield page


def write_log(path: Path, board: str) -> None:
    """A recording with an alarm of the twin."""
    writer = LogWriter(path)
    alarm = pb.Alarm(name="divergence-x", active=True, host_time_ns=START_NS, text="The ball is elsewhere.")
    for n in range(SECONDS * 10):
        at_ns = START_NS + n * 100_000_000
        state = pb.State(tick=50 * n, session=1, host_time_ns=at_ns, x_m=3e-3, mode=pb.MODE_CLOSED_LOOP)
        writer.write(f"board51/{board}/state", state.SerializeToString(), at_ns)
        if n % 10 == 5:
            writer.write(f"board51/{board}/twin/alarm", alarm.SerializeToString(), at_ns)
    writer.close()


def test_a_replay_beside_a_live_rig_is_no_rig_and_nothing_for_stop(rig: Rig, bus: Bus) -> None:
    visitor = hmi_peers.Page(rig.port)
    visitor.open()
    marks: list[zenoh.ZBytes | None] = []
    subscriber = bus.session.declare_subscriber("board51/*/state", lambda s: marks.append(s.attachment))
    log = rig.folder / "logs" / "of-demo.mcap"
    with Process(rig.folder, "replay", str(log), "--connect", rig.endpoint, "--speed", "50"):
        wait_for(lambda: len(bus.states("demo")) > 100, "the replay on the bus")
        with visitor.live("/live") as live:
            board_names = [board["name"] for _ in range(5) for board in frame(live)["boards"]]
    stop = visitor.post("/api/*/stop")  # what the replay left must not be asked either
    subscriber.undeclare()

    assert {bytes(mark) if mark is not None else b"" for mark in marks} == {b"", b"replayed"}
    assert set(board_names) == {"rig"}
    assert (stop.status_code, list(stop.json()["boards"])) == (200, ["rig"])


def test_a_campaign_that_is_starting_is_given_up_by_a_stop(rig: Rig, bus: Bus) -> None:
    """Its process listens to the bus only after a while, and would miss the STOP."""
    visitor = hmi_peers.Page(rig.port)
    visitor.open()

    started = visitor.post("/api/rig/job", {"kind": "campaign", "act": "start", "quick": True})
    stop = visitor.post("/api/rig/stop")

    assert (started.json()["accepted"], stop.json()["accepted"]) == (True, True)
    with visitor.live("/live/rig") as live:
        wait_for(lambda: not frame(live).get("jobs", {}).get("campaign", {"running": True})["running"], "its end")
    records = [record for record in bus.messages["rig/command/record"] if record.reply.accepted]
    kinds = {record.command.WhichOneof("what") for record in records if record.reply.tick >= stop.json()["tick"]}
    assert kinds <= {"stop"}


@needs_browser
def test_a_page_of_a_recording_has_no_act_of_the_live_rig(page: Page, rig: Rig, bus: Bus) -> None:
    """Of a rig of the same name: its alarms, its model, its jobs."""
    visitor = hmi_peers.Page(rig.port)
    visitor.open()
    recording = visitor.post("/api/rig/job", {"kind": "record", "act": "start", "title": "live"})
    replay = visitor.post("/api/*/job", {"kind": "replay", "act": "start", "log": "logs/of-rig.mcap"})
    assert recording.json()["accepted"]
    assert replay.json()["accepted"]

    page.goto(f"{rig.url}/replay/rig")
    expect(page.locator(".alarm .name").first).to_contain_text("divergence-x")
    page.wait_for_selector("body[data-live=yes]")
    text = page.locator("body").inner_text()
    acts = page.locator("[data-act]:not([data-act=stop]), [data-command]").count()
    to_model = page.locator("a[href^='/model']").count()
    visitor.post("/api/*/job", {"kind": "replay", "act": "stop"})
    visitor.post("/api/rig/job", {"kind": "record", "act": "stop"})

    assert (acts, to_model) == (0, 0)
    assert "record" not in text.replace("REPLAY of a recording", "")


@needs_browser
@pytest.mark.parametrize("end", ["highest", "lowest"])
def test_the_ends_of_the_range_on_the_page_are_within_the_limits(page: Page, rig: Rig, bus: Bus, end: str) -> None:
    """Typed in mm, in the log as the number that was typed."""
    bus.command(uuid.uuid4().hex, stop=pb.Stop())
    page.goto(f"{rig.url}/rig/rig")
    words = page.locator('[data-live="reference-range"]')
    expect(words).to_contain_text("mm")
    low, _, rest = words.inner_text().partition(" to ")
    typed = low if end == "lowest" else rest.partition(" ")[0]
    before = len(bus.messages["rig/command/record"])

    page.locator("input[name=mm]").fill(typed)
    page.get_by_role("button", name="Set", exact=True).click()

    record = wait_for(lambda: bus.messages["rig/command/record"][before:], "the command")[0]
    assert record.command.set_reference.x_ref_m == float(f"{typed}e-3")
    assert record.reply.reason in ("", "slew"), record.reply.text
