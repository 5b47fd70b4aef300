"""The web page on a guarded bus: https with the plant's authority, people's roles down to the gateway and its log."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, expect
from playwright.sync_api import Page as Tab

from gateway.access.roles import Role
from gateway.access.users import User, set_token
from gateway.processes.command import ADAPTER
from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from protocol.log.reader import read
from tests.harness.gateway.access_peers import PASSWORD, guarded_rig, made_folder
from tests.harness.gateway.api_peers import Program
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, start_job
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, Process, hmi
from tests.harness.ports import free_port
from tests.patience import HANG_MS, WORK_MS

pytestmark = pytest.mark.xdist_group("hmi-access")
in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason=ABSENT)


class Plant:
    """An emulated board behind a guarded gateway, and its page, all as processes."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self.keys, self._stack = folder, made_folder(folder / "keys"), stack
        self.endpoint, self.port = f"tls/127.0.0.1:{free_port()}", free_port()
        emulator = stack.enter_context(Process(folder, "emulate", "--pty", str(folder / "tty"), *ADAPTER))
        emulator.wait_for_words("tty")
        words = ("--board", f"rig={folder / 'tty'}", "--listen", self.endpoint, "--security", str(self.keys.path))
        self.gateway = Process(folder, "gateway", *words, "--log-dir", str(folder / "logs"))
        stack.enter_context(self.gateway).wait_for_words("streaming")
        twin = ("twin", "--connect", self.endpoint, "--identity", str(self.keys.path / "identities" / "twin"))
        stack.enter_context(Process(folder, *twin))
        self.hmi = self.start_hmi()

    def start_hmi(self) -> Process:
        _, process = self._stack.enter_context(
            hmi(self.folder, self.endpoint, "--security", str(self.keys.path), port=self.port)
        )
        return process

    def records(self) -> list[pb.CommandRecord]:
        """Return the command records in the gateway's log; call it when the gateway has ended."""
        logs = sorted((self.folder / "logs").glob("*.mcap"))
        return [record.message for record in read(logs, topics=("command/record",))]  # type: ignore[misc]  # by topic


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with ExitStack() as stack:
        yield Plant(tmp_path_factory.mktemp("guarded"), stack)


@contextmanager
def logged_in(browser: Browser, plant: Plant, name: str) -> Iterator[Tab]:
    """The rig's page of a person who has come in by the form."""
    # Chromium takes authorities from the system's store only; that httpx trusts ours is the test at the end.
    context = browser.new_context(viewport={"width": 1400, "height": 900}, ignore_https_errors=True)
    context.set_default_timeout(HANG_MS)
    tab = context.new_page()
    tab.goto(f"https://127.0.0.1:{plant.port}/rig/rig")
    log_in(tab, name)
    tab.wait_for_url(f"https://127.0.0.1:{plant.port}/rig/rig")
    tab.wait_for_selector("body[data-live=yes]")
    yield tab
    context.close()


def log_in(tab: Tab, name: str) -> None:
    tab.get_by_label("Name").fill(name)
    tab.get_by_label("Password").fill(PASSWORD)
    tab.get_by_role("button", name="Log in").click()


@pytest.mark.slow
@in_a_browser
def test_a_page_whose_server_restarted_asks_to_log_in_again(browser: Browser, plant: Plant) -> None:
    with logged_in(browser, plant, "ben") as tab:
        plant.hmi.kill()
        plant.hmi = plant.start_hmi()

        expect(tab.get_by_text("Your session is over. Log in again.")).to_be_visible()
        log_in(tab, "ben")
        tab.wait_for_url(f"https://127.0.0.1:{plant.port}/rig/rig")
        tab.wait_for_selector("body[data-live=yes]")


@in_a_browser
@pytest.mark.slow
def test_from_a_campaign_to_a_better_model_by_an_engineer_s_buttons(browser: Browser, plant: Plant) -> None:
    """Each answer comes onto the page by itself; the emulated rig has its coil higher than the nominal model."""
    with logged_in(browser, plant, "ben") as tab:
        tab.get_by_role("link", name="Campaign, diagnosis, hand-over").click()
        expect(tab.get_by_text("The twin runs on ce152")).to_be_visible()
        assert tab.get_by_role("button", name="Run quick").count() == 0, "an operator may not"

    with logged_in(browser, plant, "ana") as tab:
        tab.goto(f"https://127.0.0.1:{plant.port}/model/rig")
        start_job(tab, "Run quick (35 s)")
        expect(tab.locator(".job-lines").first).to_contain_text("[1/")
        start_job(tab, "Identify")
        expect(tab.locator(".results").get_by_text("identified model, campaign of")).to_be_visible(timeout=WORK_MS)
        start_job(tab, "Diagnose, quick")
        expect(tab.locator(".sentence")).to_contain_text("coil sits", timeout=WORK_MS)
        expect(tab.get_by_role("img", name="Prediction error")).to_be_visible()
        models = tab.locator(".card", has_text="Models")
        extended = models.locator(".file", has_text="extended model")
        extended.get_by_role("button", name="Hand over to the twin").click()
        expect(extended.get_by_text("in use")).to_be_visible()
        expect(tab.get_by_text("handed over by ana")).to_be_visible()
        expect(tab.locator('[data-live="hand-over-said"]')).to_contain_text(": done")
        before = models.locator(".file", has_text="before a hand-over")
        before.get_by_role("button", name="Return to this model").click()
        expect(before.get_by_text("in use")).to_be_visible()
    plant.gateway.end()

    (folder,) = (plant.folder / "data" / "campaigns").iterdir()
    assert len(load(folder).recordings) >= 8
    excitations = [record for record in plant.records() if record.command.HasField("excite")]
    assert len(excitations) >= 8
    assert {(r.command.who, r.command.role, r.reply.accepted) for r in excitations} == {("ana", "engineer", True)}


@pytest.mark.slow
def test_a_person_s_command_reaches_the_board_under_that_person_s_name_and_role(tmp_path: Path) -> None:
    folder = made_folder(tmp_path / "keys")
    with (
        guarded_rig(folder, tmp_path / "logs") as rig,
        hmi(tmp_path, rig.endpoint, "--security", str(folder.path)) as (port, _),
        rig.join("vic") as bus,
    ):
        page = Page(port, ca=folder.ca)
        cookie = page.log_in("ben", PASSWORD).headers["set-cookie"]

        def known() -> bool:
            return page.post("/api/rig/command", {"ping": {}}).json()["accepted"] is True

        wait_for(known, "the board behind the page")
        stopped = page.post("/api/rig/stop")
        wait_for(lambda: any(r.command.HasField("stop") for r in bus.records), "the record")
        forbidden = page.post("/api/rig/command", {"set_stream": {"divider": 2}})

        assert "Secure" in cookie
        assert "max-age=31536000" in page.http.get("/login").headers["strict-transport-security"]
        assert stopped.status_code == 200
        assert "STOP" in rig.board.names()
        record = next(r for r in bus.records if r.command.HasField("stop"))
        assert (record.command.who, record.command.role) == ("ben", "operator")
        assert (forbidden.status_code, forbidden.json()["refused_by"]) == (403, "hmi")
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(f"https://127.0.0.1:{port}/login")


@pytest.mark.slow
def test_a_program_s_command_reaches_the_board_under_its_user_s_name_and_the_token_s_role(tmp_path: Path) -> None:
    folder = made_folder(tmp_path / "keys")
    token = set_token(folder.users, "matlab", User(name="ana", role=Role.OPERATOR))
    with (
        guarded_rig(folder, tmp_path / "logs") as rig,
        hmi(tmp_path, rig.endpoint, "--security", str(folder.path)) as (port, _),
        rig.join("vic") as bus,
    ):
        program = Program(port, token, ca=folder.ca)
        wait_for(lambda: program.command(command="ping").json()["executed"], "the board behind the API")
        stopped = program.post("/rigs/rig/stop")
        wait_for(lambda: any(r.command.HasField("stop") for r in bus.records), "the record")
        forbidden = program.command(command="stream", divider=2)

    record = next(r for r in bus.records if r.command.HasField("stop"))
    assert stopped.json()["executed"]
    assert (record.command.who, record.command.role) == ("ana", "operator")
    assert (forbidden.status_code, forbidden.json()["code"]) == (403, "not-allowed")
