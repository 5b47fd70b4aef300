"""The daemon in the line: emulated board, real zenoh, real log."""

from __future__ import annotations

from pathlib import Path

import pytest
import zenoh

from gateway.daemon import open_bus
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.errors import ServiceError
from tests.harness.gateway.gateway_peers import (
    closed_loop,
    gapless,
    gateway_and_client,
    gateway_config,
    logged_messages,
    running,
    wait_for,
    with_log,
)
from tests.harness.soak.stage import Disk


def test_every_tick_arrives_and_is_logged_the_same(tmp_path: Path) -> None:
    with Emulator(tcp=False) as emulator:
        with gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus:
            states = bus.await_states(600)

    assert gapless(states)
    (log,) = tmp_path.glob("*.mcap")
    logged = [m for m in logged_messages(log, "state") if isinstance(m, pb.State)]
    state_of_tick = {m.tick: m for m in logged}
    assert gapless(logged)
    assert all(state_of_tick[s.tick] == s for s in states)


def test_batches_hold_every_tick_once_as_it_is_logged(tmp_path: Path) -> None:
    """With nobody on `state`, too: no single samples go out then, and no latency is measured."""
    batches: list[pb.StateBatch] = []
    statuses: list[pb.Status] = []
    with Emulator() as emulator, running(config := gateway_config(*emulator.urls, log=tmp_path)):
        with zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=config.zenoh.listen))) as session:
            session.declare_subscriber(
                "board51/rig/states", lambda s: batches.append(pb.StateBatch.FromString(s.payload.to_bytes()))
            )
            session.declare_subscriber(
                "board51/rig/status", lambda s: statuses.append(pb.Status.FromString(s.payload.to_bytes()))
            )
            wait_for(lambda: sum(len(batch.states) for batch in batches) > 600, "samples in batches")
            status = wait_for(lambda: next((s for s in statuses if s.samples > 600), None), "a status")

    states = [state for batch in batches for state in batch.states]
    (log,) = tmp_path.glob("*.mcap")
    state_of_tick = {message.tick: message for message in logged_messages(log, "state")}
    assert gapless(states)
    assert all(state_of_tick[state.tick] == state for state in states)
    assert len(batches) < len(states) / 4
    assert (status.latency_p99_ms, status.publish_dropped) == (0.0, 0)


def test_parameters_status_and_the_liveliness_token_are_there() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        status = wait_for(
            lambda: next((s for s in bus.messages["rig/status"] if s.samples_per_s > 450), None), "status"
        )
        parameters = wait_for(lambda: bus.messages["rig/parameters"], "parameters")[0]
        tokens = [r.ok for r in bus.session.liveliness().get("board51/*/alive") if r.ok is not None]

    assert (status.link, status.samples_lost, status.log_state) == ("streaming", 0, "off")
    assert status.line_load == pytest.approx(0.65, abs=0.1)
    assert 0 < status.latency_p50_ms <= status.latency_p99_ms
    assert (parameters.sample_time_s, parameters.stream_divider) == (0.002, 1)
    assert list(parameters.gains) == pytest.approx([0.49, 1700.0, 17.7, -17600.0], rel=2**-14)
    assert [str(token.key_expr) for token in tokens] == ["board51/rig/alive"]


def test_commands_are_always_answered_and_executed_once(tmp_path: Path) -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus:
        closed_loop(bus)
        first = bus.command("a", set_reference=pb.SetReference(x_ref_m=3e-3))
        again = bus.command("a", set_reference=pb.SetReference(x_ref_m=3e-3))
        other = bus.command("a", set_reference=pb.SetReference(x_ref_m=2e-3))
        far = bus.command("b", set_reference=pb.SetReference(x_ref_m=9e-3))
        malformed, empty, large = bus.request(b"\xff\xff"), bus.request(b""), bus.request(b"\x00" * 10_000)
        state = wait_for(lambda: next((s for s in bus.states() if s.tick >= first.tick), None), "state")
        stop = bus.command("s", stop=pb.Stop())
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")

    assert (first.accepted, first.refused_by, first.attempts) == (True, "", 1)
    assert again == first
    assert state.x_ref_m == pytest.approx(3e-3, abs=1.5e-6)
    assert [r.reason for r in (other, far, malformed, empty, large)] == [
        "id-reused", "out-of-range", "malformed", "bad-id", "oversize",
    ]  # fmt: skip
    assert stop.accepted
    records = logged_messages(next(tmp_path.glob("*.mcap")), "command/record")
    assert [r.command.id for r in records] == ["mode", "a", "a", "b", "", "", "", "s"]
    assert {r.command.who for r in records} == {"test", ""}


def test_a_flood_is_refused_and_stop_gets_through() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        closed_loop(bus)
        replies = [
            bus.session.get("board51/rig/command", payload=pb.Command(id=f"p{n}", ping=pb.Ping()).SerializeToString())
            for n in range(300)
        ]
        stop = bus.command("s", stop=pb.Stop())
        reasons = [pb.CommandReply.FromString(r.ok.payload.to_bytes()).reason for g in replies for r in g if r.ok]

    assert stop.accepted
    assert len(reasons) == 300
    assert reasons.count("flood") + reasons.count("queue-full") > 100


def test_a_capture_arrives_while_other_commands_pass() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        capture = pb.Capture(u_from_v=0.0, u_to_v=2.0, duration_s=0.08, pre_s=0.004)
        assert bus.command("c", capture=capture).accepted
        pings = [bus.command(f"p{n}", ping=pb.Ping()).accepted for n in range(5)]
        (record,) = wait_for(lambda: bus.messages["rig/capture"], "capture")

    assert all(pings)
    assert (len(record.i_c_a), record.step_index, record.sample_time_s) == (2000, 100, pytest.approx(4e-5))
    # Before the step no current; afterwards K_A u_c, about 0.3 A/V; noise of the converter is a few counts of 0.5 mA.
    assert max(record.i_c_a[:100]) < 0.02
    assert record.i_c_a[-1] > 0.3


def test_an_interrupted_capture_is_said_to_be() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        assert bus.command("c", capture=pb.Capture(u_from_v=0.0, u_to_v=2.0, duration_s=0.08)).accepted
        assert bus.command("s", stop=pb.Stop()).accepted

        assert "STOP" in bus.await_event("capture-failed").text
        assert bus.messages["rig/capture"] == []


def test_a_full_disk_stops_the_log_and_not_the_samples(tmp_path: Path) -> None:
    with Emulator() as emulator:
        config = with_log(gateway_config(*emulator.urls, log=tmp_path), min_free_bytes=10**13)
        with gateway_and_client(config) as bus:
            status = wait_for(lambda: next((s for s in bus.messages["rig/status"] if s.log_state), None), "status")
            states = bus.await_states(100)

    assert status.log_state == "disk-full"
    assert gapless(states)


def test_a_gateway_that_starts_on_a_full_disk_serves_and_logs_when_there_is_room(tmp_path: Path) -> None:
    disk = Disk(tmp_path / "disk")
    if not disk.mounted:
        pytest.skip("no right to mount a small disk")
    (disk.folder / "ballast").write_bytes(bytes(4096))
    disk.fill(leave=0)
    try:
        with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls, log=disk.folder)) as bus:
            status = wait_for(lambda: next(iter(bus.messages["rig/status"]), None), "status")
            alarms = wait_for(lambda: next((a.active for a in bus.messages["rig/alarms"] if a.active), None), "alarms")
            states = bus.await_states(100)
            disk.free()
            resumed = bus.await_event("log-resumed")
            bus.await_states(100)
        (log,) = disk.folder.glob("*.mcap")
        logged, samples = logged_messages(log, "event"), logged_messages(log, "state")
    finally:
        disk.close()

    assert status.log_state == "disk-full"
    assert "log-failing" in [alarm.name for alarm in alarms]
    assert "-000.mcap" in resumed.text
    full = next(event for event in logged if event.name == "log-disk-full")
    assert full.text.endswith("Free space on that file system; logging then continues by itself.")
    assert gapless(samples)
    assert {state.tick for state in states} <= {state.tick for state in samples}  # the queue held them


def test_what_the_twin_says_is_in_the_log(tmp_path: Path) -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus:
        alarm = pb.Alarm(name="divergence-x", active=True, tick=7)
        bus.session.put("board51/rig/twin/alarm", alarm.SerializeToString())
        bus.session.put("board51/rig/twin/nonsense", b"x")
        wait_for(lambda: bus.messages["rig/twin/alarm"], "alarm")
        bus.await_states(100)

    assert logged_messages(next(tmp_path.glob("*.mcap")), "twin/alarm") == [alarm]


def test_a_taken_endpoint_is_an_error() -> None:
    config = gateway_config("/dev/null")
    with open_bus(config):
        with pytest.raises(ServiceError, match="Cannot listen"), open_bus(config):
            pass
