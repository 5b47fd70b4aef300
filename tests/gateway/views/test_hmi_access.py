"""The rights of each role at the web page: commands, alarms, logs, reports, models, and STOP before all."""

from __future__ import annotations

import io
import os
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor

import pytest

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import frame
from tests.harness.gateway.hmi_server import STOP, Server
from twin.model.parameters import Model

pytestmark = pytest.mark.xdist_group("hmi-access")


@pytest.fixture
def server(hmi_server: Server) -> Server:
    return hmi_server


@pytest.mark.parametrize(
    ("name", "body", "status"),
    [
        ("vic", {"stop": {}}, 200),
        ("vic", {"set_mode": {"mode": "MODE_IDLE"}}, 403),
        ("vic", {"set_reference": {"x_ref_m": 0.003}}, 403),
        ("ben", {"set_reference": {"x_ref_m": 0.003}}, 200),
        ("ben", {"set_mode": {"mode": "MODE_IDLE"}}, 200),
        ("ben", {"mark": {"text": "here"}}, 200),
        ("ben", {"set_gains": {"law": 0, "gains": [1, 2, 3, 4]}}, 403),
        ("ben", {"set_host_loss": {"policy": 0, "timeout_s": 1}}, 403),
        ("ben", {"id": "mine", "who": "ana", "stop": {}}, 400),
        ("ben", {"what": "stop"}, 400),
        ("ben", {}, 400),
        ("ben", {"set_reference": {"x_ref_m": "far"}}, 400),
    ],
)
def test_a_role_may_what_the_table_says_and_no_more(
    server: Server, name: str, body: dict[str, object], status: int
) -> None:
    page = server.page(name)
    before = len(server.gateway.commands)

    answer = page.post("/api/rig/command", body)

    assert answer.status_code == status, answer.text
    assert len(server.gateway.commands) - before == (status == 200)
    if status == 200:
        assert server.gateway.commands[-1][1].who == name, "the log shows who did it"
    if status == 403:
        assert answer.json()["reason"] == "not-allowed"


def test_an_alarm_is_listed_until_an_operator_has_seen_it(server: Server) -> None:
    server.gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=True, text="more than noise"))

    def alarm(field: str, expected: object) -> bool:
        with server.page("vic").live("/live/rig") as live:
            listed = next(f["rest"]["alarms"] for f in iter(lambda: frame(live), None) if "rest" in f)
        return any(a["name"] == "divergence-x" and a[field] == expected for a in listed)

    wait_for(lambda: alarm("acknowledged", False), "the alarm")
    assert server.page("vic").post("/api/rig/acknowledge", {"name": "divergence-x"}).status_code == 403
    assert server.page("ben").post("/api/rig/acknowledge", {"name": "divergence-x"}).status_code == 200
    assert alarm("by", "ben")
    assert server.page("ben").post("/api/rig/acknowledge", {"name": "nothing"}).json()["reason"] == "no-alarm"
    assert server.page("ben").post("/api/rig/acknowledge", {"name": 7}).status_code == 400


def test_the_last_report_opens_and_can_reach_nothing(server: Server) -> None:
    folder = server.folder / "data" / "campaigns" / "rig-20260102-030405" / "diagnosis"
    folder.mkdir(parents=True)
    (folder / "report.html").write_text("<p>air-gap-offset")
    page = server.page("vic")

    text = page.open("/rig/rig")
    address = "/report/" + text.partition("/report/")[2].partition('"')[0]
    around = page.http.get(address, headers={"accept": "text/html"})
    report = page.http.get(address.replace("/report/", "/report-file/"))

    assert 'sandbox="allow-same-origin"' in around.text
    assert "air-gap-offset" not in around.text
    assert "air-gap-offset" in report.text
    policy = report.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-same-origin; default-src 'none'")
    assert "script" not in policy


def test_controls_are_on_the_pages_of_those_who_may_use_them(server: Server) -> None:
    pages = [server.page(name).open("/rig/rig") for name in ("vic", "ben")]
    viewer, operator = (page.partition("<body>")[2] for page in pages)  # the head has the texts of all controls

    assert "STOP" in viewer, "whoever sees that something goes wrong may stop it"
    for control in ("Closed loop", "Start excitation", "Mark now"):
        assert control in operator
        assert control not in viewer
    assert "Gains from a file" not in operator, "an engineer's"
    assert "Run quick" not in operator


def test_a_refusal_of_the_gateway_comes_back_with_its_reason(server: Server) -> None:
    page = server.page("ben")
    usual = server.gateway.answer
    server.gateway.answer = lambda _, command: pb.CommandReply(
        id=command.id, refused_by="gateway", reason="slew", text="The jump is too large."
    )

    answer = page.post("/api/rig/command", {"set_reference": {"x_ref_m": 0.003}})

    server.gateway.answer = usual
    assert answer.status_code == 409
    body = answer.json()
    assert (body["accepted"], body["refused_by"], body["reason"]) == (False, "gateway", "slew")


def test_a_log_is_deleted_by_an_engineer_alone_and_never_while_it_is_written(server: Server) -> None:
    logs, campaign = server.folder / "logs", server.folder / "data" / "campaigns" / "rig-20260303-030303"
    campaign.mkdir(parents=True)
    for path in (logs / "old.mcap", logs / "open.mcap", campaign / "rest.mcap"):
        path.write_bytes(b"log")
    for path in (logs / "old.mcap", campaign / "rest.mcap"):
        os.utime(path, (1e9, 1e9))

    def delete(name: str, log: object) -> object:
        return server.page(name).post("/api/*/delete", {"log": log}).json()["reason"]

    assert delete("ben", "logs/old.mcap") == "not-allowed"
    assert delete("ana", "logs/open.mcap") == "in-use"
    assert delete("ana", "campaigns/rig-20260303-030303/rest.mcap") == "of-a-campaign"
    assert delete("ana", "../secret.mcap") == "no-log"
    assert delete("ana", 7) == "malformed"
    assert (logs / "old.mcap").exists()
    assert delete("ana", "logs/old.mcap") == ""
    assert not (logs / "old.mcap").exists()
    for path in (logs / "open.mcap", campaign / "rest.mcap"):
        path.unlink()


def test_a_model_leaves_the_page_as_a_file_for_another_tool(server: Server) -> None:
    models = server.folder / "data" / "models" / "rig"
    models.mkdir(parents=True)
    Model.load("ce152").save(models / "a.json")
    (models / "b.json").write_text('{"plant": {"name": "ce152"}}')
    page = server.page("vic")

    answer = page.http.get("/api/rig/export/kept/a.json?to=matlab")
    assert answer.headers["content-disposition"] == 'attachment; filename="a.zip"'
    assert zipfile.ZipFile(io.BytesIO(answer.content)).testzip() is None
    broken = page.http.get("/api/rig/export/kept/b.json?to=fmu")
    assert broken.status_code == 409
    assert "kept/b.json" in broken.json()["text"]
    for name, to in (("kept/a.json", "exe"), ("kept/absent.json", "fmu"), ("kept/..%2f..%2f..%2fusers.toml", "fmu")):
        assert page.http.get(f"/api/rig/export/{name}?to={to}").status_code == 404


@pytest.mark.parametrize(("held_up_s", "executed"), [(0.1, True), (30.0, False), (-30.0, False), (float("nan"), False)])
def test_what_the_network_held_up_is_not_done_and_stop_is(server: Server, held_up_s: float, executed: bool) -> None:
    page, before = server.page("ben"), len(server.gateway.commands)
    headers = {"x-board51-seen": f"{time.monotonic() - held_up_s:.3f}"}

    mark = page.post("/api/rig/command", {"mark": {"text": "here"}}, **headers)
    stop = page.post(STOP, **headers)

    assert (mark.status_code == 200) is executed
    assert executed or mark.json()["reason"] == "not-fresh"
    assert stop.status_code == 200
    assert len(server.gateway.commands) - before == 1 + executed


def test_one_stop_stops_every_board_and_says_what_became_of_each(server: Server) -> None:
    usual = server.gateway.answer
    server.gateway.state("other")
    page = server.page("vic")
    with page.live("/live") as live:
        wait_for(lambda: {b["name"] for b in frame(live)["boards"]} >= {"rig", "other"}, "both boards")

    def answer(key: str, command: pb.Command) -> pb.CommandReply | None:
        return usual(key, command) if "/rig/" in key else pb.CommandReply(refused_by="link", reason="timed-out")

    server.gateway.answer = answer
    before = len(server.gateway.commands)
    stopped = page.post("/api/*/stop")
    server.gateway.answer = usual

    assert stopped.status_code == 409, "not all of them"
    boards = stopped.json()["boards"]
    assert {name: boards[name]["accepted"] for name in ("rig", "other")} == {"rig": True, "other": False}
    assert {key.split("/")[1] for key, _ in server.gateway.commands[before:]} >= {"rig", "other"}


def test_a_stop_does_not_wait_for_commands_that_are_not_answered(server: Server) -> None:
    """More of them than the server has threads for."""
    usual = server.gateway.answer
    server.gateway.answer = lambda key, command: usual(key, command) if command.HasField("stop") else None
    pages = [server.page("ben") for _ in range(8)]

    with ThreadPoolExecutor(40) as pool:
        held = [pool.submit(page.post, "/api/rig/command", {"mark": {"text": "x"}}) for page in pages * 5]
        wait_for(lambda: len(server.gateway.unanswered) >= 5, "commands that wait")
        stopped = pages[0].post(STOP)
        waiting = [future for future in held if not future.done()]
        server.gateway.answer = usual
        server.gateway.give_up()

    assert stopped.status_code == 200
    assert len(waiting) > 20, "it was answered before them"
