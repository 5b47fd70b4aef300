"""Summaries of logs beside the commands of an operator: a real rig, a real page, real processes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from gateway.views.hmi.turns import WAITING
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import Bus, client, wait_for
from tests.harness.gateway.hmi_peers import Page
from tests.harness.gateway.rig_peers import Rig, emulated_rig
from tests.harness.gateway.summary_peers import Viewers, children, write_log
from tests.patience import HANG_S

pytestmark = pytest.mark.slow  # test_dispatch.py guards that a STOP waits for nobody, without a rig
VIEWERS = 40  # more than asyncio has threads on a machine of 32 cores
PATIENCE_S = 3.0  # of the operator's browser
CLOSED = {"set_mode": {"mode": "MODE_CLOSED_LOOP"}}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with emulated_rig(tmp_path_factory.mktemp("hmi-summaries")) as rig:
        write_log(rig.folder / "logs" / "big.mcap", 60_000)
        yield rig


@pytest.fixture
def bus(rig: Rig) -> Iterator[Bus]:
    with client(rig.endpoint) as bus:
        wait_for(bus.states, "a sample")
        yield bus


@pytest.fixture
def page(rig: Rig, bus: Bus) -> Iterator[Page]:
    page = Page(rig.port)
    page.open()
    wait_for(lambda: page.post("/api/rig/stop").status_code == 200, "the rig on the page")
    yield page
    page.http.close()


@pytest.fixture
def viewers(page: Page) -> Iterator[Viewers]:
    viewers = Viewers(page)
    yield viewers
    viewers.leave()


def records(bus: Bus) -> list[pb.CommandRecord]:
    return list(bus.messages["rig/command/record"])


def test_nothing_acts_after_a_stop_however_many_summaries_are_read(
    rig: Rig, page: Page, bus: Bus, viewers: Viewers
) -> None:
    """An operator closes the loop beside them, the browser gives up, and somebody stops the rig."""
    viewers.request_summaries(VIEWERS)
    wait_for(lambda: children(rig.hmi.pid), "a summary that is being read")

    with contextlib.suppress(httpx.TimeoutException):
        page.http.timeout = httpx.Timeout(PATIENCE_S)
        page.post("/api/rig/command", CLOSED)
    page.http.timeout = httpx.Timeout(HANG_S)
    stop = page.post("/api/rig/stop").json()
    viewers.leave()
    wait_for(lambda: not children(rig.hmi.pid), "the end of all summaries")

    assert stop["accepted"]
    assert page.post("/api/rig/command", {"mark": {"text": "afterwards"}}).json()["accepted"]
    wait_for(lambda: records(bus) and records(bus)[-1].command.mark.text == "afterwards", "the remark")
    kinds = [(r.command.WhichOneof("what"), r.reply.tick) for r in records(bus) if r.reply.accepted]
    after = kinds[kinds.index(("stop", stop["tick"])) + 1 :]
    assert [kind for kind, _ in after] == ["mark"]
    bus.await_states(10)
    assert bus.states()[-1].mode == pb.MODE_IDLE


def test_sessions_are_found_by_a_condition_and_a_wrong_one_is_said(page: Page, rig: Rig) -> None:
    os.utime(rig.folder / "logs" / "big.mcap", (1.7e9, 1.7e9))  # finished long ago

    table = page.http.get("/api/sessions", params={"where": "samples = 60000"}).json()["text"]
    wrong = page.http.get("/api/sessions", params={"where": "--json"}).json()["text"]

    assert "big.mcap" in table
    assert table.endswith("1 row\n")
    assert "cannot be answered" in wrong


def test_one_summary_is_read_at_a_time_and_ends_with_its_request(rig: Rig, page: Page, viewers: Viewers) -> None:
    viewers.request_summaries(WAITING + 1)
    viewers.request_summaries(3)

    (first,) = wait_for(lambda: children(rig.hmi.pid), "a summary that is being read")
    refused = wait_for(lambda: viewers.statuses().count(503), "refusals")
    lower = os.getpriority(os.PRIO_PROCESS, first) - os.getpriority(os.PRIO_PROCESS, rig.hmi.pid)
    viewers.leave()

    wait_for(lambda: not children(rig.hmi.pid), "its end")
    assert refused <= 3
    assert lower >= 0
    wait_for(lambda: not Path(f"/proc/{first}").exists(), "the end of its process")


def test_a_summary_is_what_info_prints(page: Page) -> None:
    answer = page.http.get("/api/summary/logs/big.mcap").json()

    assert answer["accepted"]
    assert answer["text"].startswith("logs/big.mcap: ")
    assert "60000 messages" in answer["text"]
