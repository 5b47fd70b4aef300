"""Events, alarms, and work on models by the API: programs against the running server of a played gateway."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from websockets.sync.client import ClientConnection

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.api_peers import ApiServer
from tests.harness.gateway.design_files import CAMPAIGN, GAINS
from tests.harness.gateway.gateway_peers import wait_for
from tests.patience import HANG_S

pytestmark = pytest.mark.xdist_group("hmi-api")
ALARM = pb.Alarm(name="divergence-x", active=True, host_time_ns=7, text="x is off")
MODEL = f"{CAMPAIGN}/model.json"


def until(stream: ClientConnection, kind: str, **expected: object) -> dict[str, Any]:
    """The next notice of that kind with these values."""
    while True:
        notice = json.loads(stream.recv(timeout=HANG_S))[kind]
        if notice is not None and expected.items() <= notice.items():
            result: dict[str, Any] = notice
            return result


def test_events_are_listed_the_oldest_first(api: ApiServer) -> None:
    program = api.program("vic")
    for n in range(3):
        api.gateway.send("event", pb.Event(name=f"made-{n}", host_time_ns=1500000000 + n, text="made", tick=n))
    wait_for(
        lambda: (
            program.json("/rigs/rig/events", last=1)["events"][-1:]
            and program.json("/rigs/rig/events", last=1)["events"][0]["name"] == "made-2"
        ),
        "the events",
    )
    events = program.json("/rigs/rig/events", last=2)["events"]

    assert [event["name"] for event in events] == ["made-1", "made-2"]
    assert (events[1]["tick"], events[1]["text"]) == (2, "made")
    assert [program.get("/rigs/rig/events", last=last).status_code for last in (0, 201)] == [400, 400]


def test_a_stream_tells_events_and_the_life_of_an_alarm(api: ApiServer) -> None:
    """It comes, an operator acknowledges it, it goes; a second reader that leaves takes nothing from the first."""
    with api.program("vic").stream(what="events/stream") as stream:
        with api.program("ben").stream(what="events/stream"):
            api.gateway.send("twin/alarm", ALARM)
            came = until(stream, "alarm", name="divergence-x", active=True)
        listed = api.program("vic").json("/rigs/rig/alarms")["alarms"]
        forbidden = api.program("vic").command(command="acknowledge", alarm="divergence-x")
        answer = api.program("ben").command(command="acknowledge", alarm="divergence-x", comment="seen")
        (_, command) = api.gateway.commands[-1]
        reply = pb.CommandReply(accepted=True)
        api.gateway.send("command/record", pb.CommandRecord(command=command, reply=reply, received_ns=9))
        quiet = until(stream, "alarm", name="divergence-x", acknowledged=True)
        api.gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=False, host_time_ns=11))
        over = until(stream, "alarm", name="divergence-x", active=False)
        api.gateway.send("event", pb.Event(name="seen-live", source="gateway", severity="info"))
        event = until(stream, "event", name="seen-live")

    assert (came["severity"], came["acknowledged"], came["text"]) == ("warning", False, "x is off")
    assert "divergence-x" in [alarm["name"] for alarm in listed]
    assert (forbidden.status_code, answer.json()["executed"]) == (403, True)
    assert (command.who, command.acknowledge.comment) == ("ben", "seen")
    assert (quiet["active"], quiet["acknowledger"]) == (True, "ben")
    assert over["acknowledged"]
    assert (event["source"], event["severity"]) == ("gateway", "info")
    assert "divergence-x" not in [alarm["name"] for alarm in api.program("vic").json("/rigs/rig/alarms")["alarms"]]


def test_an_alarm_is_shelved_and_brought_back(api: ApiServer) -> None:
    api.gateway.send("twin/alarm", pb.Alarm(name="innovation", active=True, host_time_ns=7, text="high"))
    ben = api.program("ben")
    details: dict[str, Any] = {"alarm": "innovation", "comment": "known"}

    def entry() -> dict[str, Any]:
        listed = api.program("vic").json("/rigs/rig/alarms")["alarms"]
        return next((alarm for alarm in listed if alarm["name"] == "innovation"), {})

    wait_for(entry, "the alarm")
    forbidden = api.program("vic").command(command="shelve", shelve_s=600.0, **details)
    malformed = [ben.command(command="shelve", shelve_s=wrong, **details) for wrong in (0.0, -1.0, 90000.0)]
    shelved, during = ben.command(command="shelve", shelve_s=600.0, **details).json(), entry()
    api.gateway.send("twin/alarm", pb.Alarm(name="innovation", active=False, host_time_ns=11))
    wait_for(lambda: entry()["active"] is False, "its end, on the shelf")
    ended_entry = entry()
    back = ben.command(command="unshelve", **details).json()

    assert forbidden.status_code == 403
    assert [answer.json()["code"] for answer in malformed] == 3 * ["malformed"]
    assert (shelved["executed"], back["executed"]) == (True, True)
    assert 0.0 < during["shelved_until_s"] - time.time() <= 600.0
    assert (ended_entry["shelved_until_s"], ended_entry["acknowledger"]) == (during["shelved_until_s"], "ben")
    assert entry() == {}


def test_a_late_reader_is_told_the_alarms_that_stand(api: ApiServer) -> None:
    api.gateway.send("twin/alarm", pb.Alarm(name="divergence-i", active=True, host_time_ns=7, text="i is off"))
    wait_for(lambda: "divergence-i" in api.program("vic").get("/rigs/rig/alarms").text, "the alarm")

    with api.program("vic").stream(what="events/stream") as stream:
        assert until(stream, "alarm", name="divergence-i")["active"]
    assert api.program("vic").get("/rigs/rig/events/stream").status_code == 426


def test_a_capture_of_another_session_is_not_the_one_that_was_started(api: ApiServer) -> None:
    program = api.program("vic")
    assert program.get("/rigs/rig/capture").json()["code"] == "no-capture"
    record = pb.CaptureRecord(
        session=1, tick=50, sample_time_s=4e-5, u_from_v=1, u_to_v=2, step_index=1, i_c_a=[0.25, 0.5]
    )
    api.gateway.send("capture", record)
    wait_for(lambda: program.get("/rigs/rig/capture").status_code == 200, "the capture")
    same = program.get("/rigs/rig/capture", from_tick=50, format="csv")
    api.gateway.state(session=2)
    wait_for(lambda: program.json("/rigs/rig/state")["session"] == 2, "the new session")

    assert same.text == "t_s,i_c_a,u_c_v\n-4e-05,0.25,1.0\n0.0,0.5,2.0\n"
    assert program.get("/rigs/rig/capture", from_tick=50).status_code == 404
    assert program.json("/rigs/rig/capture")["i_c_a"] == [0.25, 0.5]


def test_a_design_is_a_result_with_the_command_that_loads_it(api: ApiServer) -> None:
    result = api.program("vic").json("/rigs/rig/results/design")
    sent = api.program("ana").command(**result["command"])
    (_, command) = api.gateway.commands[-1]

    assert (result["is_loaded"], result["problem"], result["loops"][2]["phase_margin_deg"]) == (False, "", 24.5)
    assert sent.json()["executed"], sent.text
    assert list(command.set_gains.gains) == GAINS
    assert api.program("vic").json("/rigs/rig/results/forecast", campaign=CAMPAIGN)["lost"] == 3


@pytest.mark.parametrize(
    ("path", "query", "code"),
    [
        ("/rigs/rig/results/validation", {}, "no-result"),
        ("/rigs/rig/results/nothing", {}, "no-result"),
        ("/rigs/rig/results/design", {"campaign": "../x"}, "no-campaign"),
        ("/rigs/nix/results/design", {}, "no-board"),
        ("/rigs/nix/jobs", {}, "no-board"),
    ],
)
def test_what_is_not_there_is_answered_with_a_remedy(
    api: ApiServer, path: str, query: dict[str, str], code: str
) -> None:
    answer = api.program("vic").get(path, **query)

    assert (answer.status_code, answer.json()["code"]) == (404, code)
    assert answer.json()["remedy"]


def test_jobs_need_the_rights_that_the_page_asks_for(api: ApiServer) -> None:
    validate, hand_over = {"job": "validate"}, {"job": "hand-over", "model": MODEL}
    design = {"job": "design", "model": MODEL, "x_m": 2.85e-3}
    refused = [api.program(who).post("/rigs/rig/jobs", body) for who in ("vic", "ben") for body in (hand_over, design)]

    assert {answer.status_code for answer in refused} == {403}
    assert api.program("vic").post("/rigs/rig/jobs", validate).status_code == 403
    assert api.program("vic").post("/rigs/rig/jobs/stop", {"job": "validate"}).status_code == 403
    assert api.program("vic").json("/rigs/rig/jobs") == {"jobs": []}


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({}, "malformed"),
        ({"job": "campaign"}, "malformed"),
        ({"job": "validate", "model": MODEL}, "malformed"),
        ({"job": "design", "model": MODEL}, "malformed"),
        ({"job": "design", "model": MODEL, "x_m": 2.85e-3, "settling_s": 0}, "malformed"),
        ({"job": "design", "model": MODEL, "x_m": 2.85}, "out-of-range"),
        ({"job": "design", "model": "nothing", "x_m": 2.85e-3}, "no-model"),
        ({"job": "hand-over", "model": "nothing"}, "no-model"),
        ({"job": "validate", "campaign": "nothing"}, "no-campaign"),
        ({"job": "compare", "first": MODEL, "second": MODEL}, "same-model"),
        ({"job": "forecast", "campaign": CAMPAIGN}, "no-flight"),
    ],
)
def test_a_job_that_cannot_start_is_refused_in_words(api: ApiServer, body: dict[str, object], code: str) -> None:
    answer = api.program("ana").post("/rigs/rig/jobs", body).json()

    assert (answer["executed"], answer["code"]) == (False, code)
    assert answer["message"]
    assert answer["remedy"]


@pytest.mark.parametrize("kind", ["validate", "design", "hand-over"])
def test_a_job_runs_and_its_end_is_told(api: ApiServer, kind: str) -> None:
    """The model of this campaign is not whole, and no twin runs: each ends with an error in a sentence."""
    program = api.program("ana")
    more: dict[str, dict[str, object]] = {
        "validate": {},
        "design": {"model": MODEL, "x_m": 2.85e-3, "settling_s": 0.2},
        "hand-over": {"model": MODEL},
    }

    started = program.post("/rigs/rig/jobs", {"job": kind, **more[kind]})

    def ended() -> dict[str, Any] | None:
        of_kind = {job["kind"]: job for job in program.json("/rigs/rig/jobs")["jobs"]}
        latest: dict[str, Any] = of_kind[kind]
        return None if latest["running"] else latest

    job = wait_for(ended, "its end")
    assert started.json()["executed"], started.text
    assert job["who"] == "ana"
    assert job["failed"]
    assert job["standing"]
    assert program.post("/rigs/rig/jobs/stop", {"job": kind}).json()["code"] == "not-running"


def test_a_job_can_be_started_by_a_form(api: ApiServer) -> None:
    form = {"job": "design", "model": MODEL, "x_m": "2.85", "settling_s": "0.2"}

    answer = api.program("ana").http.post("/api/v1/rigs/rig/jobs", data=form)

    assert answer.json()["code"] == "out-of-range", "2.85 m: the numbers were read, and the act was asked"
