"""The daemon in the line: emulated board, real zenoh, real log."""

from __future__ import annotations

import itertools
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh

import board51
from gateway.config import GatewayConfig, ZenohConfig
from gateway.daemon import open_bus
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.errors import ServiceError
from protocol.log.reader import read
from protocol.log.scan import Scan
from tests.harness.gateway.gateway_peers import (
    Bus,
    ScriptedBoard,
    client,
    gateway_and_client,
    gateway_config,
    running,
    wait_for,
    with_log,
)
from tests.harness.ports import free_port
from tests.patience import HANG_S


def gapless(states: list[pb.State]) -> bool:
    return all(b.tick == a.tick + 1 and b.lost_before == 0 for a, b in itertools.pairwise(states))


def consistent(states: list[pb.State]) -> bool:
    """Within a session every missing tick is counted."""
    pairs = itertools.pairwise(states)
    return all(b.session != a.session or b.tick == a.tick + 1 + b.lost_before for a, b in pairs)


def closed_loop(bus: Bus, board: str = "rig") -> None:
    assert bus.command("mode", board, set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)).accepted


def test_every_tick_arrives_and_is_logged_the_same(tmp_path: Path) -> None:
    with Emulator(tcp=False) as emulator:
        with gateway_and_client(gateway_config(*emulator.urls, log=tmp_path)) as bus:
            states = bus.await_states(600)

    assert gapless(states)
    (log,) = tmp_path.glob("*.mcap")
    logged = [m for m in logged_messages(log, "state") if isinstance(m, pb.State)]
    by_tick = {m.tick: m for m in logged}
    assert gapless(logged)
    assert all(by_tick[s.tick] == s for s in states)


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
    by_tick = {message.tick: message for message in logged_messages(log, "state")}
    assert gapless(states)
    assert all(by_tick[state.tick] == state for state in states)
    assert len(batches) < len(states) / 4
    assert (status.latency_p99_ms, status.publish_dropped) == (0.0, 0)


def logged_messages(log: Path, topic: str) -> list[Any]:
    return [record.message for record in read(log, topics=[topic])]


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
        malformed, nothing, large = bus.ask(b"\xff\xff"), bus.ask(b""), bus.ask(b"\x00" * 10_000)
        state = wait_for(lambda: next((s for s in bus.states() if s.tick >= first.tick), None), "state")
        stop = bus.command("s", stop=pb.Stop())
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")

    assert (first.accepted, first.refused_by, first.attempts) == (True, "", 1)
    assert again == first
    assert state.x_ref_m == pytest.approx(3e-3, abs=1.5e-6)
    assert [r.reason for r in (other, far, malformed, nothing, large)] == [
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


@pytest.mark.parametrize("tcp", [True, False])
def test_an_unplugged_board_comes_back_as_a_new_session(tcp: bool) -> None:
    with Emulator(tcp=tcp) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        before = bus.await_states(50)[-1].session
        emulator.disconnect()
        bus.await_event("port-lost")
        down = bus.command("x", ping=pb.Ping())
        emulator.reconnect()
        wait_for(lambda: bus.states()[-1].session != before, "new session")
        again = bus.command("x", ping=pb.Ping())

    assert (down.refused_by, down.reason) == ("link", "link-down")
    assert again.accepted
    assert consistent(bus.states())


def test_an_adapter_may_come_back_under_another_name(tmp_path: Path) -> None:
    with Emulator(tcp=False, pty=tmp_path / "usb") as emulator:
        with gateway_and_client(gateway_config(str(tmp_path / "usb*"))) as bus:
            before = bus.await_states(50)[-1].session
            emulator.disconnect()
            bus.await_event("port-lost")
            emulator.reconnect(renamed=True)

            wait_for(lambda: bus.states()[-1].session != before, "new session")
            status = wait_for(
                lambda: next((s for s in bus.messages["rig/status"] if s.reconnects == 1), None), "status"
            )

    assert status.port == str(tmp_path / "usb-renamed")


def test_a_reset_of_the_board_is_a_new_session_and_not_a_loss() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        before = bus.await_states(300)[-1]
        emulator.reset_board()
        new = wait_for(lambda: [s for s in bus.states() if s.session != before.session], "new session")
        bus.await_event("reset-power-on")
        bus.await_states(100)

    assert new[0].tick < before.tick
    assert consistent(bus.states())
    assert len({s.session for s in bus.states()}) == 2


def test_noise_costs_frames_and_every_one_is_counted() -> None:
    with Emulator(faults=("flip=2e-3", "lost=1e-3", "duplicate=1e-3", "insert=1e-3"), seed=3) as emulator:
        with gateway_and_client(gateway_config(*emulator.urls)) as bus:
            replies = [bus.command(f"p{n}", ping=pb.Ping()) for n in range(20)]
            states = bus.await_states(1000)
            status = wait_for(
                lambda: next((s for s in bus.messages["rig/status"] if sum(s.bad_frames.values()) > 10), None), "status"
            )

    assert consistent(states)
    assert sum(s.lost_before for s in states) > 0
    assert len({s.session for s in states}) == 1
    assert sum(r.accepted for r in replies) >= 19  # a try fails with 2-5 %, five tries all together once in 10^6
    assert status.samples_lost > 0


def test_a_stall_of_the_line_loses_nothing_it_kept() -> None:
    with Emulator(tcp=True) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        emulator.inject("stall=0.5")
        states = bus.await_states(700)

    assert consistent(states)
    assert len({s.session for s in states}) == 1


def test_two_gateways_on_one_tty_do_not_share_it() -> None:
    with Emulator(tcp=False) as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        second = gateway_config(*emulator.urls)
        with running(second), client(second.zenoh.listen[0]) as other:
            status = wait_for(lambda: other.messages["rig/status"], "status")[0]
            reply = other.command("p", ping=pb.Ping())
        states = bus.await_states(100)

    assert status.link == "absent"
    assert "in use" in reply.text
    assert gapless(states)


STALLED = """
import sys, time, zenoh
with zenoh.open(zenoh.Config.from_json5(sys.argv[1])) as session:
    session.declare_subscriber("board51/**", lambda sample: None)
    print("ready", flush=True)
    time.sleep(60)
"""


def test_a_stopped_subscriber_costs_neither_others_nor_the_log_a_sample(tmp_path: Path) -> None:
    with Emulator(boards=2) as emulator:
        config = gateway_config(*emulator.urls, log=tmp_path)
        with gateway_and_client(config) as bus:
            text = zenoh_config("client", connect=config.zenoh.listen)
            stopped = subprocess.Popen([sys.executable, "-c", STALLED, text], stdout=subprocess.PIPE)
            assert stopped.stdout is not None
            stopped.stdout.readline()
            stopped.send_signal(signal.SIGSTOP)
            try:
                states = bus.await_states(1500, "rig0")
            finally:
                stopped.kill()
                stopped.wait()
                stopped.stdout.close()
            bus.await_states(200, "rig0")

    assert gapless(states)
    for name in ("rig0", "rig1"):
        logged = [r.message for r in read(next(tmp_path.glob("*.mcap")), topics=["state"], boards=[name])]
        assert len(logged) > 1500
        assert gapless([m for m in logged if isinstance(m, pb.State)])


@contextmanager
def router_process(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-m", "board51", "router", "--listen", endpoint]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    try:
        process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_router_may_go_and_come_back() -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    router = zenoh_config("router", listen=[endpoint])
    with Emulator() as emulator:
        config = gateway_config(*emulator.urls)
        config = GatewayConfig(
            boards=config.boards, zenoh=ZenohConfig(mode="client", connect=(endpoint,)), log=config.log
        )
        with running(config):
            with zenoh.open(zenoh.Config.from_json5(router)), client(endpoint) as bus:
                before = bus.await_states(50)[-1]
            with zenoh.open(zenoh.Config.from_json5(router)), client(endpoint) as bus:
                after = bus.await_states(50)[-1]
                assert bus.command("p", ping=pb.Ping()).accepted

    assert after.session == before.session
    assert after.tick > before.tick


@pytest.mark.slow
@pytest.mark.parametrize("queue", [8192, 64], ids=["all wait", "most are dropped"])
def test_what_subscribers_miss_while_the_router_is_away_is_counted(
    queue: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "gateway")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        routers = [stack.enter_context(router_process(endpoint))]
        board = stack.enter_context(ScriptedBoard())
        config = gateway_config(board.url, stale_s=HANG_S)
        config = replace(config, zenoh=ZenohConfig(mode="client", connect=(endpoint,), queue=queue))
        stack.enter_context(running(config))
        bus = stack.enter_context(client(endpoint))
        bus.await_states(50)
        # What zenoh and the system hold when a router is killed is not known to have arrived: here they hold nothing.
        board.streaming = False
        wait_for(lambda: bus.states()[-1].sequence == board.tick & 0xFFFF, "the last sample")
        before = wait_for(lambda: bus.messages["rig/status"], "status")[-1]

        routers[0].kill()
        routers[0].wait()
        wait_for(lambda: [r for r in caplog.records if "No router" in r.message], "the gateway's notice")
        taken_before = bus.states()[-1].tick
        board.streaming = True
        seen = board.tick
        wait_for(lambda: board.tick > seen + 500, "samples during the outage")
        # The new router subscribes itself: a client of it may come back after the gateway, which it cannot know.
        router = zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))
        late = Bus(stack.enter_context(zenoh.open(router)))
        back = late.await_event("bus-back")
        late.await_states(50)
        after = wait_for(
            lambda: [s for s in late.messages["rig/status"] if s.host_time_ns > back.host_time_ns], "status"
        )[-1]

    ticks = [s.tick for s in late.states()]
    lost_on_the_line = sum(taken_before < tick <= ticks[-1] for tick in board.not_taken)
    missing = ticks[-1] - taken_before - len(ticks) - lost_on_the_line
    counted = after.publish_dropped - before.publish_dropped
    assert ticks == sorted(ticks)
    assert (counted > 400) == (queue == 64)
    assert str(counted) in back.text or not counted
    assert missing == counted


def test_a_full_disk_stops_the_log_and_not_the_samples(tmp_path: Path) -> None:
    with Emulator() as emulator:
        config = with_log(gateway_config(*emulator.urls, log=tmp_path), min_free_bytes=10**13)
        with gateway_and_client(config) as bus:
            status = wait_for(lambda: next((s for s in bus.messages["rig/status"] if s.log_state), None), "status")
            states = bus.await_states(100)

    assert status.log_state == "disk-full"
    assert gapless(states)


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


# -- as a user starts it


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--board NAME=PORT"),
        (["--board", "rig1"], "NAME=PORT"),
        (["--board", "Rig 1=/dev/null"], "is not a name"),
        (["--board", "a=x", "--board", "a=y"], "twice"),
        (["--board", "a=nonsense://x"], "nonsense"),
        (["--board", "a=/dev/null", "--listen", "127.0.0.1:7447"], "is not a zenoh endpoint"),
        (["--board", "a=/dev/null", "--log-dir", "/proc/nowhere"], "--no-log"),
        (["--config", "absent.toml"], "cannot be read"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(
    arguments: list[str], says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    listen = [] if "--listen" in arguments else ["--listen", f"tcp/127.0.0.1:{free_port()}"]

    code = board51.main(["gateway", *arguments, *listen])

    said = capfd.readouterr().err
    assert code == 2
    assert len(said.splitlines()) == 1
    assert says in said


def test_the_printed_configuration_is_one_that_passes_the_check(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert board51.main(["gateway", "--print-config"]) == 0
    (tmp_path / "gateway.toml").write_text(capfd.readouterr().out)

    assert board51.main(["gateway", "--config", str(tmp_path / "gateway.toml"), "--check"]) == 0

    done = capfd.readouterr()
    assert done.err == ""
    assert "rig1 at /dev/ttyUSB0" in done.out


PANICS = """
import os, pathlib, sys, threading, time
import board51

def panic():  # what Rust writes, in the way it writes it: to the descriptor, past Python
    while not list(pathlib.Path(sys.argv[1]).glob("*.mcap")):
        time.sleep(0.01)
    os.write(2, b"\\nthread 'rx-0' (4711) panicked at zenoh/src/net/routing/dispatcher/resource.rs:823:44:\\n")

threading.Thread(target=panic, daemon=True).start()
sys.exit(board51.main(sys.argv[2:]))
"""


def test_a_panic_in_a_thread_of_zenoh_ends_it_in_good_order_to_be_started_again(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ScriptedBoard() as board:
        words = ["gateway", "--board", f"rig={board.url}", "--listen", endpoint, "--log-dir", str(tmp_path)]
        done = subprocess.run(
            [sys.executable, "-c", PANICS, str(tmp_path), *words],
            stderr=subprocess.PIPE,
            text=True,
            timeout=HANG_S,
            check=False,
        )
    (log,) = tmp_path.glob("*.mcap")

    assert done.returncode == 70
    assert "its process ends" in done.stderr
    assert "panicked at" not in done.stderr  # a gateway that reads this of a view does not end, too
    assert Scan(log).indexed


PANICS_AT_THE_END = """
import os, signal, sys, threading, time
import board51
from protocol.ending import end_is_ordered

def panic():
    while signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGTERM)
    while not end_is_ordered():
        time.sleep(0.001)
    os.write(2, b"\\nthread 'net-0' (4711) panicked at zenoh/src/net/routing/dispatcher/resource.rs:491:27:\\n")

threading.Thread(target=panic, daemon=True).start()
sys.exit(board51.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "service", ["gateway", *(pytest.param(view, marks=pytest.mark.slow) for view in ("hmi", "opcua"))]
)
def test_a_panic_while_zenoh_closes_is_no_failure(service: str, tmp_path: Path) -> None:
    """zenoh panics in some of its ends; `systemctl stop` must not leave "failed" behind by luck."""
    with Emulator(tcp=False) as emulator, running(config := gateway_config(*emulator.urls)):
        endpoint = config.zenoh.listen[0]
        logs = ["--log-dir", str(tmp_path)]
        own = {
            "gateway": ["--board", "rig=/dev/null", "--listen", f"tcp/127.0.0.1:{free_port()}", *logs],
            "hmi": ["--connect", endpoint, "--listen", f"127.0.0.1:{free_port()}", "--data", str(tmp_path)],
            "opcua": ["--connect", endpoint, "--listen", f"127.0.0.1:{free_port()}"],
        }
        done = subprocess.run(
            [sys.executable, "-c", PANICS_AT_THE_END, service, *own[service]],
            stderr=subprocess.PIPE, text=True, timeout=HANG_S, check=False,
        )  # fmt: skip

    assert done.returncode == 0, done.stderr


def test_a_terminal_that_closes_ends_it_cleanly(tmp_path: Path) -> None:
    """As at the end of an ssh connection: the terminal is gone, whoever writes to it gets an error."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    master, slave = os.openpty()
    with ScriptedBoard() as board:
        words = ["--board", f"rig={board.url}", "--listen", endpoint, "--log-dir", str(tmp_path)]
        gateway = subprocess.Popen(
            ["setsid", "--ctty", sys.executable, "-m", "board51", "gateway", *words],
            stdin=slave, stdout=slave, stderr=slave,
        )  # fmt: skip
        try:
            os.close(slave)
            with client(endpoint) as bus:
                wait_for(bus.states, "first sample")
            os.close(master)
            code = gateway.wait(30.0)
        finally:
            gateway.kill()
            gateway.wait()
    (log,) = tmp_path.glob("*.mcap")

    assert code == 0
    assert Scan(log).indexed


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_cleanly_and_moves_nothing(number: signal.Signals, tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        emulator = stack.enter_context(Emulator())
        # Not a second, as by default: the next gateway may take longer to come on a busy machine.
        board = f'[[board]]\nname = "rig"\nport = "{emulator.urls[0]}"\nhost_loss_timeout_s = 30.0\n'
        (tmp_path / "gateway.toml").write_text(board)
        arguments = ["--config", str(tmp_path / "gateway.toml"), "--listen", endpoint, "--log-dir", str(tmp_path)]
        gateway = subprocess.Popen(
            [sys.executable, "-m", "board51", "gateway", *arguments], stderr=subprocess.PIPE, text=True
        )
        stack.enter_context(gateway)
        stack.callback(gateway.kill)  # where the test fails before the signal
        with client(endpoint) as bus:
            closed_loop_when_up(bus)
            bus.await_states(100)
            gateway.send_signal(number)
            _, lines = gateway.communicate(timeout=HANG_S)
        second = gateway_config(*emulator.urls)
        with gateway_and_client(second) as bus:
            mode = bus.states()[0].mode

    assert gateway.returncode == 0
    assert Scan(next(tmp_path.glob("*.mcap"))).indexed
    assert "streaming" in lines
    assert "Traceback" not in lines
    assert mode == pb.MODE_CLOSED_LOOP
    commands = {r.command.WhichOneof("what") for r in logged_messages(next(tmp_path.glob("*.mcap")), "command/record")}
    assert commands == {"set_mode"}


def closed_loop_when_up(bus: Bus) -> None:
    wait_for(bus.states, "first sample")
    closed_loop(bus)
