"""A program without zenoh flies the emulated ball by the API: HTTP, CSV, WebSocket, a campaign, metrics."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from websockets.exceptions import ConnectionClosed

from tests.harness.gateway.api_peers import Program
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import drain
from tests.harness.gateway.rig_peers import Rig, emulated_rig
from tests.patience import HANG_S

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("hmi-api-rig")]
CLIENTS = Path(__file__).parents[3] / "docs" / "clients"
X_M = 3.2e-3


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with emulated_rig(tmp_path_factory.mktemp("api-rig")) as rig:
        program = Program(rig.port)
        wait_for(lambda: program.get("/rigs/rig").status_code == 200, "the board at the API")
        wait_for(lambda: program.json("/rigs/rig")["limits"], "its limits, which come every 5 s")
        yield rig


@pytest.fixture
def flight(rig: Rig) -> Iterator[Program]:
    """The ball held at X_M; the coil is off afterwards."""
    program = Program(rig.port)
    assert program.command(command="mode", mode="closed-loop").json()["executed"]
    assert program.command(command="reference", x_ref_m=X_M).json()["executed"]
    wait_for(lambda: abs(program.json("/rigs/rig/state")["x_m"] - X_M) < 5e-5, "the ball at its place")
    yield program
    assert program.post("/rigs/rig/stop").json()["executed"]


def test_status_and_state_say_what_the_ball_does(flight: Program) -> None:
    def live() -> dict[str, Any] | None:
        (entry,) = flight.json("/rigs")["rigs"]
        return entry if entry["link"] == "live" else None

    entry, status = wait_for(live, "the rig live"), flight.json("/rigs/rig")

    assert (entry["name"], entry["mode"], entry["coil"]) == ("rig", "closed-loop", "on")
    assert abs(status["x_ref_m"] - X_M) < 1e-6
    assert status["limits"]["x_ref_min_m"] < X_M < status["limits"]["x_ref_max_m"]
    assert (status["twin"], status["divergence"]) == ("none", None)
    flight.post("/rigs/rig/stop")

    def off() -> bool:
        state = flight.json("/rigs/rig/state")
        return bool(state["mode"] == "idle" and state["u_c_v"] == 0.0)

    wait_for(off, "the coil off")


def test_recent_samples_are_every_tick_in_both_forms(flight: Program) -> None:
    wait_for(lambda: len(flight.json("/rigs/rig/states", last_s=60)["tick"]) > 1000, "two seconds of samples")
    columns = flight.json("/rigs/rig/states", last_s=1.5)
    text = flight.get("/rigs/rig/states", last_s=60, format="csv")
    rows = list(csv.DictReader(io.StringIO(text.text)))

    assert text.headers["content-type"].startswith("text/csv")
    assert {len(values) for values in columns.values()} == {len(columns["tick"])}
    assert len(columns["tick"]) > 1
    assert columns["host_time_s"][-1] - columns["host_time_s"][0] <= 1.5
    assert all(
        b - a == 1 + lost for (a, b), lost in zip(pairwise(columns["tick"]), columns["lost_before"][1:], strict=True)
    )
    row_at_tick = {int(row["tick"]): row for row in rows}
    for n, tick in enumerate(columns["tick"]):
        assert {name: float(row_at_tick[tick][name]) for name in ("t_s", "i_c_a", "x_m", "u_c_v", "x_ref_m")} == {
            name: columns[name][n] for name in ("t_s", "i_c_a", "x_m", "u_c_v", "x_ref_m")
        }
        assert row_at_tick[tick]["mode"] == columns["mode"][n]
    assert flight.json("/rigs/rig/states", last_s=0)["tick"] == []


@pytest.mark.parametrize("rate_hz", [20, 500])
def test_a_stream_is_even_and_counts_what_is_missing(flight: Program, rate_hz: int) -> None:
    count = 2 * rate_hz
    with flight.stream(f"?rate_hz={rate_hz}") as stream:
        samples: list[dict[str, Any]] = [json.loads(stream.recv(timeout=HANG_S)) for _ in range(count)]

    # The first interval and one whose last sample was lost may be shorter or longer.
    steps = [b["tick"] - a["tick"] for a, b in pairwise(samples[1:])]
    assert sorted(steps)[len(steps) // 2] == 500 // rate_hz
    assert all(1 <= step for step in steps)
    assert set(samples[0]) == set(flight.json("/rigs/rig/state"))


def test_a_stream_of_csv_begins_with_its_header(flight: Program) -> None:
    with flight.stream("?rate_hz=100&format=csv") as stream:
        lines = [str(stream.recv(timeout=HANG_S)) for _ in range(20)]

    rows = list(csv.DictReader(lines))
    assert len(rows) == 19
    assert all(abs(float(row["x_m"]) - X_M) < 1e-3 for row in rows)


def test_what_the_board_or_gateway_refuses_leaves_the_ball_where_it_is(flight: Program) -> None:
    answer = flight.command(command="reference", x_ref_m=X_M * 1e3)

    assert (answer.status_code, answer.json()["code"]) == (409, "out-of-range")
    assert "mm" in answer.json()["message"]
    assert answer.json()["remedy"]
    assert abs(flight.json("/rigs/rig")["x_ref_m"] - X_M) < 1e-6


def test_a_plant_in_grams_is_refused_and_an_unusual_one_wants_to_be_confirmed(flight: Program) -> None:
    card = {"command": "plant", "name": "mine", "mass_kg": 8.28, "travel_m": 5.7e-3}

    grams = flight.command(**card)
    light = flight.command(**card | {"mass_kg": 8.28e-3, "gravity_m_s2": 9.7})
    confirmed = flight.command(**card | {"mass_kg": 8.28e-3, "gravity_m_s2": 9.7, "confirmed": True})

    assert (grams.status_code, grams.json()["code"]) == (409, "implausible")
    assert "0.00828" in grams.json()["message"]
    assert (light.status_code, light.json()["code"]) == (409, "not-confirmed")
    assert confirmed.json()["executed"], confirmed.text


def test_an_alarm_is_acknowledged_by_its_name_alone(flight: Program) -> None:
    answer = flight.command(command="acknowledge", alarm="no-such-alarm", comment="because")

    assert (answer.status_code, answer.json()["code"], answer.json()["refused_by"]) == (409, "no-alarm", "view")


def test_an_excitation_and_a_remark_are_in_the_log(flight: Program, rig: Rig) -> None:
    for body in (
        {"command": "excite", "shape": "rectangle", "on_reference": True, "amplitude": 2e-4, "offset": X_M,
         "period_s": 0.2, "duration_s": 0.4},
        {"command": "mark", "text": "seen by the API"}, {"command": "ping"}, {"command": "excite", "shape": "none"},
    ):  # fmt: skip
        answer = flight.post("/rigs/rig/commands", body)
        assert answer.json()["executed"], answer.text
    log = flight.json("/logs")["logs"][0]["name"]

    assert log.startswith("logs/")
    assert flight.get(f"/logs/{log}").content[:5] == b"\x89MCAP"


def test_a_capture_is_started_and_fetched_in_both_forms(flight: Program) -> None:
    flight.post("/rigs/rig/stop")
    started = flight.command(command="capture", u_from_v=0.0, u_to_v=0.5, duration_s=0.02, pre_s=0.002)
    assert started.json()["executed"], started.text
    query = {"from_tick": started.json()["tick"]}
    wait_for(lambda: flight.get("/rigs/rig/capture", **query).status_code == 200, "its samples")
    made, text = flight.json("/rigs/rig/capture"), flight.get("/rigs/rig/capture", **query, format="csv")

    rows = list(csv.DictReader(io.StringIO(text.text)))
    assert len(made["t_s"]) == len(made["i_c_a"]) == len(rows) == 500
    assert (made["t_s"][0], round(made["sample_time_s"], 9)) == (-0.002, 4e-5)
    assert [float(row["i_c_a"]) for row in rows] == made["i_c_a"]
    assert [float(row["u_c_v"]) for row in rows] == pytest.approx([0.0] * 50 + [0.5] * 450, abs=2e-3), (
        "rounded to the converter"
    )
    assert made["i_c_a"][-1] > 0.05 > made["i_c_a"][0], "the current has followed the step"
    no_capture = flight.get("/rigs/rig/capture", from_tick=2**40)
    assert (no_capture.status_code, no_capture.json()["code"]) == (404, "no-capture")


def test_a_campaign_is_started_seen_and_interrupted(rig: Rig) -> None:
    program = Program(rig.port)

    started = program.post("/rigs/rig/campaigns", {"quick": True})
    again = program.post("/rigs/rig/campaigns", {"quick": True})
    work = wait_for(lambda: program.json("/rigs/rig/campaigns")["work"], "the campaign")
    ended = program.post("/rigs/rig/campaigns/interrupt")

    assert started.json()["executed"], started.text
    assert (again.status_code, again.json()["code"]) == (409, "busy")
    assert work["running"]
    assert ended.json()["executed"]
    wait_for(lambda: not program.json("/rigs/rig/campaigns")["work"]["running"], "its end")
    assert program.post("/rigs/rig/campaigns/interrupt").json()["code"] == "not-running"
    assert program.post("/rigs/rig/campaigns", {"resume": "nothing"}).json()["code"] == "no-campaign"
    assert program.json("/rigs/rig/models")["models"] == []
    assert program.get("/rigs/rig/models/a/model.json").json()["code"] == "no-model"


def test_a_recording_is_started_and_found_among_the_logs(flight: Program, rig: Rig) -> None:
    started = flight.http.post("/api/v1/rigs/rig/recordings", data={"title": "steps"})
    wait_for(lambda: any("steps" in log["name"] for log in flight.json("/logs")["logs"]), "its file")
    stopped = flight.post("/rigs/rig/recordings/stop")

    assert started.json()["executed"], started.text
    assert stopped.json()["executed"]
    wait_for(lambda: flight.post("/rigs/rig/recordings/stop").json()["code"] == "not-running", "its end")


def test_metrics_are_those_of_the_flight(flight: Program) -> None:
    flight.command(command="reference", x_ref_m=1.0)

    def numbers() -> dict[tuple[str, str], float]:
        families = text_string_to_metric_families(flight.http.get("/metrics").text)
        return {
            (sample.name, sample.labels.get("mode") or sample.labels.get("severity", "")): sample.value
            for family in families
            for sample in family.samples
        }

    def read_metrics() -> dict[tuple[str, str], float] | None:
        now = numbers()
        live = ("board51_position_meters", "") in now  # on a busy machine samples may stay away for a moment
        return now if live and now["board51_commands_refused_total", ""] >= 1 else None

    now = wait_for(read_metrics, "a status with the refusal")
    assert abs(now["board51_position_meters", ""] - X_M) < 1e-3
    assert now["board51_mode", "closed-loop"] == 1.0
    assert now["board51_samples_received_total", ""] > 100
    assert 0.0 <= now["board51_sample_age_seconds", ""] < HANG_S
    assert now["board51_alarms", "fault"] == 0.0


def test_the_client_in_python_flies_the_ball(rig: Rig) -> None:
    program = Program(rig.port)

    process = subprocess.run(
        [sys.executable, CLIENTS / "fly.py", f"{rig.url}/api/v1/rigs/rig"],
        capture_output=True, text=True, timeout=HANG_S, check=True,
    )  # fmt: skip

    assert process.stdout.startswith("executed\n")
    height = re.search(r"x = ([0-9.]+) mm", process.stdout)
    assert height is not None
    assert abs(float(height[1]) - 3.0) < 0.2
    wait_for(lambda: program.json("/rigs/rig/state")["mode"] == "idle", "the coil off")


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no octave is installed: apt-get install octave")
def test_the_client_in_octave_flies_the_ball(rig: Rig) -> None:
    program = Program(rig.port)
    script = (
        f"s = fly('{rig.url}', 'rig'); printf('%.4f %.4f %d %d', 1e3 * s.x_m(1), 1e3 * s.x_m(end), size(s.x_m));"
        f" try, fly('{rig.url}', 'nix'); catch e, printf(' %s|%s', e.identifier, e.message); end"
    )

    process = subprocess.run(
        ["octave-cli", "--no-gui", "--no-init-file", "--quiet", "--eval", script],
        cwd=CLIENTS, capture_output=True, text=True, timeout=HANG_S, check=False,
    )  # fmt: skip

    assert process.returncode == 0, process.stderr
    first, last, rows, width, *refused = process.stdout.split()
    assert abs(float(last) - 3.5) < 0.2, "the step has arrived"
    assert abs(float(first) - 3.0) < 0.7, "recorded from before it"
    assert (int(rows) > 300, int(width)) == (True, 1)
    assert " ".join(refused).startswith("board51:no_board|No rig is called 'nix'. Take one of the rigs: rig.")
    wait_for(lambda: program.json("/rigs/rig/state")["mode"] == "idle", "the coil off")


def test_a_stream_ends_with_its_client_and_the_next_is_served(flight: Program) -> None:
    """More of them, one after the other, than are open at once."""
    for _ in range(40):
        with flight.stream("?rate_hz=500") as stream:
            assert stream.recv(timeout=HANG_S)

    with ExitStack() as stack:
        *_, last = [stack.enter_context(flight.stream("?rate_hz=1")) for _ in range(33)]
        with pytest.raises(ConnectionClosed) as closed:
            drain(last)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1013
